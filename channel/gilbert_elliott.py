"""Loss in bursts: a channel that is now good, now bad."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Annotated, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from channel.effect import Effect, probability
from channel.rng import BLOCK, Ints, Rng
from teleop.errors import Refused
from teleop.knob import Knob

Bools = NDArray[np.bool_]
_KEPT = 64  # blocks of states


class ChannelState(NamedTuple):
    """The random numbers, and the channel's state block by block: a short cache of what follows from them."""

    rng: Rng
    blocks: dict[int, Bools]


@dataclass(frozen=True, slots=True)
class GilbertElliott(Effect):
    """Two-state Markov loss (Gilbert 1960, Elliott 1963), one step per packet sent.

    From packet to packet a good channel turns bad with probability `p_good_to_bad` = p and a bad one good
    with `p_bad_to_good` = r; a packet is lost with `loss_good` = g or `loss_bad` = h. The chain starts in its
    stationary distribution (bad with p/(p + r)), so packet 0 is lost as likely as any other. Closed forms:
    mean loss L = (r g + p h)/(p + r); mean number of packets lost in a row
    L / (L - [r g ((1-p) g + p h) + p h (r g + (1-r) h)]/(p + r)), which is 1/r for g = 0, h = 1.

    Each step draws one number u: bad follows good if u < p, and bad if u < 1 - r. So every u outside
    [min, max) of those two forgets the past, between them the state stays (or turns, where p > 1 - r): the
    state at any packet is a function of its number, found by looking back to the last u that forgets.
    """

    reorders: ClassVar[bool] = False
    p_good_to_bad: Annotated[float, Knob("", "probability of turning bad, for each packet", low=0.0, high=1.0)]
    p_bad_to_good: Annotated[float, Knob("", "probability of turning good, for each packet", low=0.0, high=1.0)]
    _: KW_ONLY
    loss_good: Annotated[float, Knob("", "probability of loss while good", low=0.0, high=1.0)] = 0.0
    loss_bad: Annotated[float, Knob("", "probability of loss while bad", low=0.0, high=1.0)] = 1.0

    def __post_init__(self) -> None:
        for name in ("p_good_to_bad", "p_bad_to_good", "loss_good", "loss_bad"):
            object.__setattr__(self, name, probability(name, getattr(self, name)))
        if self.p_good_to_bad + self.p_bad_to_good == 0.0:
            raise Refused("p_good_to_bad and p_bad_to_good are both 0, so the channel never changes and has "
                          "no mean loss; write bernoulli(p) for one that stays as it is")

    @property
    def mean_loss(self) -> float:
        """The share of packets lost."""
        p, r = self.p_good_to_bad, self.p_bad_to_good
        return (r * self.loss_good + p * self.loss_bad) / (p + r)

    @property
    def mean_burst(self) -> float:
        """The mean number of packets lost in a row; 0 if none ever is, inf if all are."""
        p, r, g, h = self.p_good_to_bad, self.p_bad_to_good, self.loss_good, self.loss_bad
        both = (r * g * ((1 - p) * g + p * h) + p * h * (r * g + (1 - r) * h)) / (p + r)
        loss = self.mean_loss
        return 0.0 if loss == 0.0 else loss / (loss - both) if loss > both else float("inf")

    def begin(self, rng: Rng) -> ChannelState:
        """The random numbers; what is kept of the channel's state only saves drawing them again."""
        return ChannelState(rng, {})

    def carry(self, state: ChannelState, packet: Ints, time_ns: Ints, size: int) -> tuple[Ints, Ints, ChannelState]:
        """The packets that are spared, at once."""
        loss = np.where(self.bad(state, packet), self.loss_bad, self.loss_good)
        spared = state.rng.uniform(packet, 0, 1) >= loss
        return packet[spared], time_ns[spared], state

    def bad(self, state: ChannelState, packet: Ints) -> Bools:
        """True for each packet that meets the bad state, (n,)."""
        if not len(packet):
            return np.empty(0, np.bool_)
        blocks = np.unique(packet // BLOCK)
        all_of_them = np.concatenate([self._block(state, number) for number in blocks.tolist()])
        bad: Bools = all_of_them[np.searchsorted(blocks, packet // BLOCK) * BLOCK + packet % BLOCK]
        return bad

    def _block(self, state: ChannelState, number: int) -> Bools:
        """The states of one block of packets."""
        known = state.blocks.get(number)
        if known is None:
            bad, forgets = self._steps(state.rng, number)
            row = np.arange(BLOCK)
            since = np.maximum.accumulate(np.where(forgets, row, -1))  # the last u that forgot
            base = bad[since] if forgets[0] else np.where(since < 0, self._before(state, number), bad[since])
            known = base ^ ((row - since) % 2 == 1) if self._turns else base
            while len(state.blocks) >= _KEPT:
                del state.blocks[next(iter(state.blocks))]
            state.blocks[number] = known
        return known

    def _before(self, state: ChannelState, number: int) -> bool:
        """The state at the last packet in front of a block: back to one known, or to a u that forgets."""
        while True:  # ends at packet 0, which has nothing to remember
            number -= 1
            if number in state.blocks:
                return bool(state.blocks[number][-1])
            bad, forgets = self._steps(state.rng, number)
            rows = np.flatnonzero(forgets)
            if len(rows):  # a whole block between is an even number of turns
                return bool(bad[rows[-1]]) ^ (self._turns and (BLOCK - 1 - int(rows[-1])) % 2 == 1)

    def _steps(self, rng: Rng, number: int) -> tuple[Bools, Bools]:
        """For each packet of a block: is it bad after a good one, and is that so after a bad one too."""
        u = rng.uniform(np.arange(number * BLOCK, (number + 1) * BLOCK))
        after_good, after_bad = u < self.p_good_to_bad, u < 1.0 - self.p_bad_to_good
        forgets = after_good == after_bad
        if number == 0:
            after_good[0] = u[0] < self.p_good_to_bad / (self.p_good_to_bad + self.p_bad_to_good)
            forgets[0] = True
        return after_good, forgets

    @property
    def _turns(self) -> bool:
        """True if a u that does not forget swaps the states; else it keeps them."""
        return self.p_good_to_bad > 1.0 - self.p_bad_to_good
