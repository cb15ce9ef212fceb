"""Settings that ground stations have made, stored on disk from one run to the next."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

import msgspec

from companion.adjustable_parameters import ENABLE, checked, differences
from companion.config import Config
from companion.errors import ConfigError
from companion.events import Settings
from companion.runtime.record.disk import not_mounted, replace_file

_MOST_BYTES = 4096
_CLOSE_S = 5.0
_NO_FILE = (FileNotFoundError, NotADirectoryError)
"""Errors that prove that no settings are stored. Others may hide that the companion was switched off."""


def settings_path(config: Config) -> Path:
    """Path of the settings file: one file for each aircraft, in record.folder."""
    return Path(config.record.folder) / f"settings-{config.identity.file_name}.json"


def read_settings(config: Config) -> Settings:
    """Read the stored settings; without a file, settings in which nothing is set.

    Raises:
        ConfigError: the file cannot be read, is damaged, does not fit this configuration, or its disk is not
            mounted. The text names it.
    """
    path = settings_path(config)
    # Asked before the file is opened: the disk may be mounted at any time.
    absent = not_mounted(path.parent)
    try:
        with path.open("rb") as file:
            stored = msgspec.json.decode(file.read(_MOST_BYTES), type=Settings)
    except _NO_FILE:
        if absent is not None:
            raise ConfigError(f"{path}: {absent}") from None
        return Settings()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ConfigError(f"{path}: damaged: {error}") from error
    try:
        return checked(stored, config)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error


def usable_settings(config: Config, say: Callable[[str], None], unread: Callable[[str], None]) -> Settings:
    """The stored settings; those of the configuration if the file cannot be used, but switched off unless it
    says that the companion is switched on.

    Args:
        say: receives a line for each setting that differs from the configuration.
        unread: receives the reason why the file cannot be used.
    """
    try:
        settings = read_settings(config)
    except ConfigError as error:
        # Whoever switched the companion off did not know that another setting would not fit any more, or that
        # the file would be damaged.
        settings = Settings(enable=_enabled(config))
        off = "" if settings.enable else f"; the companion is switched off until {ENABLE} is set to 1"
        unread(f"settings: {error}; the stored settings are not used, the configuration applies{off}")
    for text in differences(config, Settings(), settings):
        say(f"settings: {text}")
    return settings


class _Switch(msgspec.Struct):
    """The one setting that is kept even if others cannot be used."""

    enable: bool = True


def _enabled(config: Config) -> bool:
    """Whether the stored settings leave the companion switched on; if unreadable or absent with their disk,
    they may not."""
    absent = not_mounted(settings_path(config).parent)
    try:
        with settings_path(config).open("rb") as file:
            return msgspec.json.decode(file.read(_MOST_BYTES), type=_Switch).enable
    except _NO_FILE:
        return absent is None
    except (OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return False


class KeptSettings:
    """Writes settings to disk when they change, in a thread, because a memory card may be slow."""

    def __init__(self, config: Config, settings: Settings) -> None:
        """Start with `settings`, which were read from disk and are therefore not written again."""
        self.error: str | None = None
        """Why the latest settings are not on disk; None if they are."""
        self._path = settings_path(config)
        self._latest = settings
        self._new = threading.Event()
        self._stop = False
        self._thread: threading.Thread | None = None

    def keep(self, settings: Settings) -> None:
        """Store the current settings if they changed. Returns at once."""
        if settings == self._latest:
            return
        self._latest = settings
        if self._thread is None:
            self._thread = threading.Thread(target=self._write_all, name="settings", daemon=True)
            self._thread.start()
        self._new.set()

    def close(self) -> None:
        """Write what is pending and wait for it, for `_CLOSE_S` at most."""
        if self._thread is not None:
            self._stop = True
            self._new.set()
            self._thread.join(_CLOSE_S)

    def _write_all(self) -> None:
        last = False
        while not last:
            self._new.wait()
            self._new.clear()
            # Read `_stop` before writing, so that settings taken before `close` are still written.
            last = self._stop
            try:
                self._path.parent.mkdir(exist_ok=True)
                replace_file(self._path, msgspec.json.encode(self._latest) + b"\n")
                self.error = None
            except OSError as error:
                self.error = f"{error.filename or self._path}: cannot be written: {error.strerror}"
