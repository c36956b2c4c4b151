"""DTLS between the two ends: who is let in, and how what they say is sealed. Needs the extra `secure`.

`keys` makes and reads the files that say who an end is; `line` is what an end holds: its line to the one peer, over as
many associations as it takes. Below it, `tunnel` is one association, `gate` lets only the holder of the pinned key
begin one, who shows by a `proof` that it is there, `context` is what OpenSSL is asked for, `data` seals what the ends
say once they have met, `record` takes datagrams apart.
"""
