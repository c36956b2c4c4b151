"""The protocol of two ends, sans-IO: bytes and the time go in, bytes and forces come out."""
