"""The commands that prepare a flight find no service manager and no status socket but the test's own."""

from tests.companion.runtime.conftest import no_service_manager

__all__ = ["no_service_manager"]
