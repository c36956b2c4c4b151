"""The shells of the live stack: timers, sockets, records. Everything here may use a clock."""
