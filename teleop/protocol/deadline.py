"""The deadline of a device: a force that is not renewed for so long is set to zero without this process. Sans-IO.

No code of an end runs when it is killed, stopped, or hung in a driver. What lets go then is the device itself, or, for
a device whose hardware cannot, a process beside the end (`teleop.live.devices.device_watchdog`), which asks `Silence`.
"""

from __future__ import annotations

DEADLINE = 0.15
"""Seconds, of the simulated devices, and the default of a device watchdog.

As long as the default watchdog of a link takes from the last packet to zero force (0.1 s and a ramp of 0.05 s), so an
end that dies lets go as soon as an end that hears nothing; and twice the 70 ms for which a machine may stall anyway.
"""

LAPSING = 0.9
"""An end that has not ticked for this share of it takes the force as lapsed: its clock is not the device's."""

LOOKS = 15  # of a device watchdog within one deadline
GRACE = 0.2  # of the deadline: what an end gets after its watchdog stood still itself


class Silence:
    """The check, every `look_ns`, that a heartbeat is not overdue. Times are ns of the machine's monotonic clock.

    A watchdog that stood still itself cannot tell whether the end did too: both may have been kept from running. So
    after a look that came late the end gets `grace_ns` to renew; but only once for each heartbeat, or a watchdog that
    is always late would never act.
    """

    def __init__(self, deadline_ns: int) -> None:
        self.deadline_ns, self.look_ns = deadline_ns, max(1, deadline_ns // LOOKS)
        self.grace_ns = round(deadline_ns * GRACE)
        self._looked: int | None = None
        self._graced, self._until = 0, 0  # the heartbeat that was given time, and until when

    def overdue(self, now: int, beat: int) -> bool:
        """True if the force is to be set to zero. `beat`: when it was renewed last; 0 means that there is no force.

        `now` has to be read before `beat` is, so that a pause between the two makes the silence shorter, not longer.
        """
        late = self._looked is not None and now - self._looked > self.look_ns + self.grace_ns
        self._looked = now
        if not beat or now - beat <= self.deadline_ns:
            return False
        if late and beat != self._graced:
            self._graced, self._until = beat, now + self.grace_ns
        return beat != self._graced or now >= self._until
