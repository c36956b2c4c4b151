"""The guard's short way through a tick at which all is well."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from teleop.protocol.guard import ForceGuard
from teleop.protocol.states import Cause, Reason
from teleop.stages.watchdog import Watchdog

DEVICE = Reason(Cause.DEVICE, "the device")


@settings(deadline=None)
@given(st.lists(st.tuples(
    st.integers(1, 3), st.booleans(), st.integers(0, 40), st.integers(0, 60), st.sampled_from([0.0, 0.02, 0.04]),
    st.sampled_from([None, None, None, None, DEVICE])), max_size=120), st.sampled_from([1, 3]))
def test_where_all_is_well_the_short_way_through_a_tick_is_the_long_one(
    ticks: list[tuple[int, bool, int, int, float, Reason | None]], every: int
) -> None:
    """Full gain stays where nothing is wrong: what is left out there changes nothing, then or later."""
    class Long(ForceGuard):
        def _is_well(self, unheard: float, age: int, silent: int) -> bool:
            return False

    guards = [kind(Watchdog(timeout=0.03, ramp=0.004, settle=0.01, age=0.05), 0.001 * every, every=every)
              for kind in (ForceGuard, Long)]
    for guard in guards:
        guard.lapse_after(0.15)
    k = 0
    for steps, got, ago, age, unheard, trouble in [(1, True, 0, 0, 0.0, None)] * 20 + ticks:
        k += steps * every
        told = [(guard.step(k, got, trouble, arrived=k - ago, unheard=unheard, age=age), guard.safe, guard.cause,
                 guard.lapsed, guard.events, guard.old) for guard in guards]
        assert told[0] == told[1]
