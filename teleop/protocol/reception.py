"""Judgement of the messages that come: presence of the other end, and consistency of its waves. Sans-IO; times are ns.

`Presence` asks whether the other end still hears this one, and whether the two count the same ticks. Each message
echoes the newest of ours that its sender has, and how long ago that came: if it is long, ours are lost on their way,
and nothing answers the force that we hold. And it bears the tick at which it was sent. No message comes before it was
sent, so one that is ahead of our grid by more than the two clocks can be apart shows that our own clock stood still, as
a suspended machine's does: our newest message is as old as the other end's messages are ahead.

`IntegralCheck` compares the integrals of a peer's waves. A sender's T, U and E (`teleop.stages.wave_integral`) grow
from nothing with the number of the message, which is the tick of the grid that it was sent at. So any two messages of a
session, g > 0 ticks of the grid apart, fulfil, whatever the wave and whatever ticks were skipped,

    dt' <= T - T' <= g dt        E >= E'        (U - U')^2 <= 2 (E - E') (T - T')

dt' being the sender's tick; less than g dt where it had no reading. Playout stays within the energy in a message, also
of one that lies. But T is a clock: after one that is far ahead no honest message would be played any more. So a message
that contradicts the newest one taken is dropped. If nothing else comes, that is silence, with which a session ends, and
the next one begins at nothing.
"""

from __future__ import annotations

from math import inf

from teleop.protocol.estimates import MOST_RTT_NS, LinkEstimates
from teleop.protocol.packet import Echo, Window
from teleop.protocol.session import Session
from teleop.protocol.states import Cause
from teleop.stages.wave_integral import Integrals

EARLY_NS = 1_000_000_000  # a message from further ahead than this is never believed: the two share one grid
STILL_NS = 50_000_000  # nor is one that is ahead by more than this, or the watchdog's timeout, and what is uncertain
STILL = 3  # ticks, of the slower end: if for so long nothing but such messages came, it is this end that stood still


class Presence:
    """Presence of the other end, by the messages of one session. This end ticks at every `every`-th tick of `dt_ns`.

    `answered`: has one come that shows that the peer hears this end. `unheard_ns`: how long the peer had heard nothing
    of this end when it sent its newest message; before the first answer, since the session began.
    """

    def __init__(self, session: Session, link: LinkEstimates, dt_ns: int, every: int, timeout_ns: int) -> None:
        self.session, self.link = session, link
        self._liveness = session.liveness
        self._dt_ns, self._every = dt_ns, every
        self._margin_ns = max(STILL_NS, timeout_ns)  # a stall of its own that is shorter is none either
        self.begin()

    def begin(self) -> None:
        """A new session."""
        self.answered, self.unheard_ns = False, 0
        self._ahead: tuple[int, int] | None = None  # since which tick messages are ahead of the grid, and by how many

    def newest(self, echo: Echo | None, sent_ns: int, now: int) -> None:
        """The newest message came at `now`, sent at `sent_ns` by our clock, with this echo."""
        if echo is None:
            self.unheard_ns = max(0, sent_ns - self.session.liveness.begun_ns)
        elif 0 <= now - echo[0] - (held_ns := echo[1]) <= MOST_RTT_NS:  # otherwise it is of one that was never sent
            self.answered, self.unheard_ns = True, held_ns
            self.session.take_echo(echo)

    def most_ahead(self) -> int:
        """Greatest number of ticks that a message can be ahead of the grid by the uncertainty of the clocks alone."""
        session = self.session
        uncertain = max(session.rtt_ns or 0, session.start_rtt_ns) // 2 + self.link.clock.sure_ns
        return min(EARLY_NS, uncertain + self._margin_ns) // self._dt_ns + 1

    def ahead(self, tick: int, ticks: int, sent_ns: int, now: int) -> None:
        """Take note that after tick `tick` a message came `ticks` ahead of the grid, which is more than `most_ahead`.

        Its send time (by the peer's clock) has to say as much: a number alone is easily forged.
        """
        before = self.link.transit_ns
        if before is not None and 2 * (before - (now - sent_ns)) > ticks * self._dt_ns:
            self._ahead = (tick if self._ahead is None else self._ahead[0], ticks)

    def in_time(self) -> None:
        """Take note that a new message came that is not ahead."""
        self._ahead = None

    def judge(self, k: int, now: int) -> None:
        """End the session if it is over for this end at tick k."""
        if self._ahead is not None and k - self._ahead[0] > STILL * max(self._every, self.session.peer_every):
            ahead = self._ahead[1] * self._dt_ns / 1e9
            self.session.end(f"stood still: the other end's messages are {ahead:.3f} s ahead of this end's clock",
                             Cause.STOOD_STILL)
        if now > self._liveness.sound_ns:
            self.session.judge(now)


Waves = tuple[Integrals, ...]  # per axis

CLOCK = 1e-6  # of a time: T is a sum of as many as 1e8 ticks, each rounded
SUM = 1e-15  # of a sum, a tick of the grid: what rounding makes of it
EVEN = 1.0 + 1e-9  # a steady wave fulfils the inequality with equality


def since(before: Waves, waves: Waves) -> Waves:
    """Integrals of waves since `before`."""
    return tuple([Integrals(*[now - then for now, then in zip(each, one, strict=True)])
                  for each, one in zip(waves, before, strict=True)])


class IntegralCheck:
    """Compares the messages of a session with the newest that was taken. `dt`: the tick of the grid, s."""

    __slots__ = ("_at", "_dt", "_then")

    def __init__(self, dt: float, axes: int) -> None:
        self._dt = dt
        self._at: int | None = None
        self._then: Waves = (Integrals(0.0, 0.0, 0.0),) * axes

    def add_up(self, seq: int, waves: Waves, every: int) -> bool:
        """True if message `seq` of a peer adds up, which ticks at every `every`-th tick of the grid."""
        ticks = seq - (self._at if self._at is not None else -every)
        newer, older = (waves, self._then) if ticks > 0 else (self._then, waves)
        apart = ticks if ticks > 0 else -ticks
        T = newer[0].T - older[0].T
        if not ((every if every < apart else apart) * (1.0 - CLOCK) <= T / self._dt <= apart * (1.0 + CLOCK)):
            return False
        slack = SUM * apart
        for new, old in zip(newer, older, strict=True):
            U = abs(new.U - old.U) - slack * (abs(new.U) + abs(old.U))
            E = new.E - old.E + slack * (new.E + old.E)
            if E < 0.0 or (U > 0.0 and not U * U <= 2.0 * EVEN * T * E < inf):
                return False
        if ticks > 0:
            self._at, self._then = seq, waves
        return True


class Reception:
    """State of one session's reception. `dt`: the tick of the grid, s; `rejoined`: it began after the peer's tick 0."""

    __slots__ = ("_first", "integrals", "newest", "rejoined", "shift_ns", "window")

    def __init__(self, dt: float, axes: int, *, rejoined: bool = False) -> None:
        self.window = Window()  # so that a copy or a replay is no second measurement
        self.integrals = IntegralCheck(dt, axes)
        self.newest: tuple[int, int, int] | None = None  # the peer's newest number, its send time, and when it came
        self.shift_ns = 0  # that this end's grid was moved by
        self.rejoined = rejoined
        self._first: Waves | None = None

    def since_first(self, waves: Waves) -> Waves:
        """Subtract the integrals of the first message of this session that this end played.

        Where both begin with tick 0, that is all they have come to. A later session's ends begin at ticks of their own,
        and what a peer sent before this end was there is no queue to play.
        """
        if self._first is None:
            self._first = waves
        return since(self._first, waves)
