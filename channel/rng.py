"""Counter-based random numbers: a draw is a pure function of (seed, direction, place, packet, draw).

The words of a packet are the first four 64-bit words of
`numpy.random.Philox(key=[seed, KEY], counter=[packet, draw, 2*place + direction, 0])`
(Philox4x64-10: Salmon, Moraes, Dror, Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC 2011). So a
draw knows nothing of the order, the block, the thread or the row of a sweep in which it is asked for.
numpy.random is imported when the first number is drawn.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from teleop.errors import Refused

if TYPE_CHECKING:
    from numpy.random import Philox

KEY = 0x74656C656F70  # the second word of every key: this project's own
BLOCK = 1024  # packets whose words are drawn and kept together for packet-by-packet use
_KEPT = 4  # blocks

Ints = NDArray[np.int64]
Words = NDArray[np.uint64]
Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


class Rng:
    """The random numbers of one effect: seed 0..2^64-1, direction 0 or 1, place in the chain from 0.

    What is kept between calls (a generator that is put in place again and again, the last blocks drawn)
    makes draws cheap and changes none. To be used by one thread at a time.
    """

    __slots__ = ("_blocks", "_generator", "_state", "direction", "place", "seed")

    def __init__(self, seed: int, direction: int, place: int) -> None:
        if isinstance(seed, bool) or not isinstance(seed, int) or not 0 <= seed < 2**64:
            raise Refused(f"seed must be a whole number from 0 to 2^64-1, not {seed!r}; write seed=1")
        if direction not in (0, 1):
            raise Refused(f"direction must be 0 (master to slave) or 1 (slave to master), not {direction!r}")
        self.seed, self.direction, self.place = seed, direction, place
        self._generator: Philox | None = None
        self._state: Any = None
        self._blocks: dict[tuple[int, int], Words] = {}

    def words(self, packet: Ints, draw: int = 0) -> Words:
        """The four words of each packet, (n, 4); packet (n,) from 0 to 2^63-1."""
        drawn, places = self._table(packet, draw)
        words: Words = drawn if places is None else drawn[places]
        return words

    def uniform(self, packet: Ints, draw: int = 0, word: int = 0) -> Floats:
        """Uniform in [0, 1) from one word of each packet, (n,)."""
        drawn, places = self._table(packet, draw)
        return unit(drawn[:, word] if places is None else drawn[:, word][places])

    def normal(self, packet: Ints, draw: int = 0) -> Floats:
        """Standard normal from words 0 and 1, (n,)."""
        return normal(self.words(packet, draw))

    def _table(self, packet: Ints, draw: int) -> tuple[Words, Ints | None]:
        """Words (m, 4), and which row each packet has; None: the rows are the packets'."""
        if not len(packet):
            return np.empty((0, 4), np.uint64), None
        low, high = int(packet.min()), int(packet.max())
        if low // BLOCK == high // BLOCK:
            return self._block(low // BLOCK, draw), packet % BLOCK
        if high - low < 2 * len(packet):  # dense: in one go, and not to be kept
            run = self._draw(low, high - low + 1, draw)
            return run, None if len(run) == len(packet) and np.all(packet[1:] > packet[:-1]) else packet - low
        blocks = np.unique(packet // BLOCK)
        words = np.concatenate([self._block(block, draw) for block in blocks.tolist()])
        return words, np.searchsorted(blocks, packet // BLOCK) * BLOCK + packet % BLOCK

    def _block(self, block: int, draw: int) -> Words:
        words = self._blocks.get((block, draw))
        if words is None:
            while len(self._blocks) >= _KEPT:
                del self._blocks[next(iter(self._blocks))]
            words = self._blocks[block, draw] = self._draw(block * BLOCK, BLOCK, draw)
        return words

    def _draw(self, packet: int, count: int, draw: int) -> Words:
        """The words of `count` packets from `packet` on, (count, 4)."""
        if self._generator is None:
            from numpy.random import Philox

            self._generator = Philox(key=np.array([self.seed, KEY], np.uint64))
            self._state = self._generator.state
        lane = 2 * self.place + self.direction
        self._state["state"]["counter"] = np.array([packet, draw, lane, 0], np.uint64)
        self._generator.state = self._state  # with the buffer of a new generator: nothing left in it
        return np.asarray(self._generator.random_raw(4 * count), np.uint64).reshape(count, 4)


def unit(word: Words) -> Floats:
    """Words as numbers in [0, 1), in steps of 2^-53."""
    return (word >> np.uint64(11)).astype(np.float64) * 2.0**-53


def inside(word: Words) -> Floats:
    """Words as numbers inside (0, 1), neither end reached, in steps of 2^-52: what a logarithm may see."""
    return ((word >> np.uint64(12)).astype(np.float64) + 0.5) * 2.0**-52


def normal(words: Words) -> Floats:
    """Standard normal from the first two of each row's words, (n, 4) -> (n,) (Box & Muller 1958)."""
    drawn: Floats = np.sqrt(-2.0 * np.log(inside(words[:, 0]))) * np.cos(2.0 * np.pi * unit(words[:, 1]))
    return drawn
