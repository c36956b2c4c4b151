"""DTLS 1.2 (RFC 6347) between the two ends: authentication by pinned keys, encryption. Needs the extra `secure`.

`keys` makes and reads the key files, which identify an end. `secure_link` is an end's link to its one peer, over as
many associations as it takes. Below it, `association` is one association; `gate` lets only the holder of the pinned key
begin one, which a `proof` shows; `path` validates the peer's address; `context` sets up OpenSSL; `data` seals the
packets once both ends are authenticated; `dtls_record` splits datagrams into records; `relayed` has a master show its
address to a relay on the way.
"""
