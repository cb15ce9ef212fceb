"""Checks the codec and the frames against reference vectors (`companion remote-id check`).

`vectors.check_file` reads a file of vectors from the public reference implementation (opendroneid-core-c) and
returns a `Report` of the differences. `check_messages`, `check_packs` and `check_frames` check one kind of
vector each, and `vector_fields` converts between the fields of a vector and our messages. The import rules
are those of `companion.remote_id` (`ROOMS` in tests/test_imports.py). Start reading at `vectors`.
"""
