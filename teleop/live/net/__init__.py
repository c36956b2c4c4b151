"""Sockets: addresses, datagrams in bulk, and a filter in the kernel of the system."""
