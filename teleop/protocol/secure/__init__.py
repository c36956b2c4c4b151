"""DTLS 1.2 (RFC 6347) between the two ends: authentication by pinned keys, encryption. Needs the extra `secure`.

`keys` makes and reads the key files, which identify an end. `secure_link` is an end's link to its one peer, over as
many associations as it takes, and validates the peer's address. Below it, `association` is one association and the
sealing of its packets; `gate` lets only the holder of the pinned key begin one; `context` sets up OpenSSL and has the
proof of that key; `dtls_record` splits datagrams into records, and has the cookie that a relay asks a master for.
"""
