"""How two ends agree to run: the first exchange, the common tick grid, the farewell. Sans-IO.

    master                      slave
      HELLO  manifest   ->
                        <-   WELCOME manifest      (or REFUSE and a sentence, and both stop)
      START  time of tick 0  ->
                        <-   START                 (the same, to say it has come)
      DATA ...          <->  DATA ...
      BYE    a reason   <->  BYE

The master repeats what is not answered. Each WELCOME echoes its HELLO, which bounds the slave's clock
against the master's: the offset is taken from the fastest round trip and is uncertain by half of that.
The master places tick 0 a little ahead on its own clock and sends it as a time on the slave's, so that
both ends count the same ticks: a packet's number is the tick it was sent at.
"""

from __future__ import annotations

from collections.abc import Mapping

from teleop.packet import Echo, Kind, Packet, encode, manifest_difference

AGAIN_NS = 50_000_000  # what is not answered is sent again after this
ROUNDS = 5  # HELLO/WELCOME round trips before the clock offset is taken
LEAD_NS = 150_000_000  # tick 0 is this far ahead when START is first sent
MOST_RTT_NS = 60_000_000_000  # of a WELCOME that is believed
MOST_CLOCK_NS = 1 << 61  # 73 years of a monotonic clock
HOLD_NS = 1_000_000_000  # a master that fell silent before START keeps others out for this long


class Session:
    """One end's side of the first exchange. `now` is the end's own monotonic clock in ns.

    `start_ns` becomes the time of tick 0 on that clock; `failure` the sentence with which this end must
    stop; `farewell` the reason the peer gave for leaving.
    """

    def __init__(self, *, master: bool, manifest: Mapping[str, str], number: int | None = None) -> None:
        self.master = master
        self.manifest = dict(manifest)
        self.number = number  # of the session; a slave takes that of the master it welcomes
        self.start_ns: int | None = None
        self.failure: str | None = None
        self.farewell: str | None = None
        self.offset_ns = 0  # the peer's clock less ours (known to the master)
        self.rtt_ns: int | None = None  # of the fastest first exchange
        self._rounds = 0
        self._acknowledged = not master
        self._next_ns: int | None = None
        self._heard_ns = 0  # when the master last spoke (known to the slave)

    def receive(self, packet: Packet, now: int) -> list[bytes]:
        """Take a control packet; the datagrams to send back at once."""
        if not self.belongs(packet, now):
            return []
        self._heard_ns = now
        if packet.kind is Kind.HELLO and not self.master:
            return self._welcome(packet, now)
        if packet.kind is Kind.WELCOME and self.master and self.start_ns is None:
            return self._measure(packet, now)
        if packet.kind is Kind.START and isinstance(packet.payload, int):
            if self.master:
                self._acknowledged = True
                return []
            if self.start_ns is None:
                self.start_ns = packet.payload
            return [self._packet(Kind.START, now, packet.payload)]
        if packet.kind is Kind.REFUSE and self.start_ns is None:
            self.failure = str(packet.payload)
        if packet.kind is Kind.BYE:
            self.farewell = str(packet.payload)
        return []

    def belongs(self, packet: Packet, now: int) -> bool:
        """Is this packet of our session, or the HELLO of one that this slave may take up?

        One session at a time: a running one is not taken over, nor one whose master has just been heard.
        """
        if packet.session == self.number:
            return True
        free = self.number is None or (self.start_ns is None and now - self._heard_ns > HOLD_NS)
        return free and packet.kind is Kind.HELLO and not self.master

    def data_came(self) -> None:
        """The peer sends DATA: it has had START."""
        self._acknowledged = True

    def due(self, now: int) -> list[bytes]:
        """What is to be sent now because it was not answered."""
        if not self.master or self.failure or (self.start_ns is not None and self._acknowledged):
            return []
        if self._next_ns is not None and now < self._next_ns:
            return []
        self._next_ns = now + AGAIN_NS
        if self.start_ns is None:
            return [self._packet(Kind.HELLO, now, self.manifest)]
        return [self._packet(Kind.START, now, self.start_ns + self.offset_ns)]

    def bye(self, reason: str, now: int) -> list[bytes]:
        """The farewell to send when this end leaves; nothing if it never met anybody."""
        return [] if self.number is None else [self._packet(Kind.BYE, now, reason)]

    def _welcome(self, hello: Packet, now: int) -> list[bytes]:
        assert isinstance(hello.payload, dict)
        self.number = hello.session
        difference = manifest_difference(self.manifest, hello.payload)
        if difference is None:
            return [self._packet(Kind.WELCOME, now, self.manifest, Echo(hello.sent_ns, 0))]
        self.failure = f"the master asks for another run: {difference}"
        theirs = manifest_difference(hello.payload, self.manifest)
        return [self._packet(Kind.REFUSE, now, f"the slave is set up for another run: {theirs}")]

    def _measure(self, welcome: Packet, now: int) -> list[bytes]:
        assert isinstance(welcome.payload, dict)
        difference = manifest_difference(self.manifest, welcome.payload)
        if difference is not None:
            self.failure = f"the slave is set up for another run: {difference}"
            return self.bye("the master refused", now)
        if welcome.echo is None:
            return []
        rtt = now - welcome.echo.sent_ns - welcome.echo.held_ns
        if not 0 <= rtt <= MOST_RTT_NS or abs(welcome.sent_ns) > MOST_CLOCK_NS:
            return []  # forged, or of a clock that nobody has
        if self.rtt_ns is None or rtt < self.rtt_ns:
            self.rtt_ns = rtt
            self.offset_ns = welcome.sent_ns - (now - rtt // 2)
        self._rounds += 1
        self._next_ns = now + AGAIN_NS
        if self._rounds < ROUNDS or self.rtt_ns is None:
            return [self._packet(Kind.HELLO, now, self.manifest)]
        self.start_ns = now + LEAD_NS + 2 * self.rtt_ns
        return [self._packet(Kind.START, now, self.start_ns + self.offset_ns)]

    def _packet(self, kind: Kind, now: int, payload: dict[str, str] | str | int, echo: Echo | None = None) -> bytes:
        assert self.number is not None
        return encode(Packet(kind, self.number, 0, now, echo, payload))
