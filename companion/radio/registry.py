"""All kinds of radio. A new kind is added here; everything else about it is in its own folder.

The order is that in which messages list the kinds.
"""

from companion.radio.arduremoteid.section import ArduRemoteIdRadio
from companion.radio.ether.section import EtherRadio
from companion.radio.hci.section import HciRadio
from companion.radio.null.section import NullRadio
from companion.radio.plugin.section import PluginRadio
from companion.radio.wifi.section import WifiRadio

RadioConfig = NullRadio | EtherRadio | HciRadio | WifiRadio | ArduRemoteIdRadio | PluginRadio
"""One [[radio]] of a configuration, of any kind."""
