"""A placeholder for a missing radio, for bench tests and for flights that only observe.

`null_radio.NullTransport` implements `companion.radio.radio.Radio`. The import rules are those of
`companion.radio` (`ROOMS` in tests/test_imports.py); these files need `events` and `remote_id`.
"""
