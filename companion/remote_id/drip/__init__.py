"""DRIP: identities that are keys (RFC 9374), and signatures over Remote ID messages (RFC 9575).

`det` makes and checks DRIP Entity Tags, the identities. `evidence` signs and reads what an aircraft signs in
flight (Wrapper and Manifest), `link` what its registry signs beforehand (Broadcast Endorsement). `keys` reads
keys and verifies with Ed25519, and `hashes` holds the two uses of cSHAKE128. Everything is pure: keys, times
and random bytes are arguments. The data goes on the air in Authentication messages of type 5, which
`companion.remote_id.authentication` splits into pages.

Sections named in this package are those of RFC 9575 unless another RFC is given. Its text was read as
draft-ietf-drip-auth-49, the version that became the RFC. Start reading at `det`, then `evidence`.
"""
