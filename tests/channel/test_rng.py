"""Random numbers: Philox as published, keyed as stated, uniform and normal."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import Generator, Philox

from channel.rng import BLOCK, KEY, Rng, inside, unit

MASK = 2**64 - 1


def philox_4x64_10(counter: list[int], key: list[int]) -> list[int]:
    """The generator as published (Salmon et al. 2011), in plain integers."""
    c, k = list(counter), list(key)
    for _ in range(10):
        one, two = 0xD2E7470EE14C6C93 * c[0], 0xCA5A826395121157 * c[2]
        c = [two >> 64 ^ c[1] ^ k[0], two & MASK, one >> 64 ^ c[3] ^ k[1], one & MASK]
        k = [(k[0] + 0x9E3779B97F4A7C15) & MASK, (k[1] + 0xBB67AE8584CAA73B) & MASK]
    return c


def test_reference_gives_the_published_vectors() -> None:
    """Known answers distributed with Random123."""
    assert philox_4x64_10([0] * 4, [0] * 2) == [
        0x16554D9ECA36314C, 0xDB20FE9D672D0FDC, 0xD7E772CEE186176B, 0x7E68B68AEC7BA23B]
    assert philox_4x64_10([MASK] * 4, [MASK] * 2) == [
        0x87B092C3013FE90B, 0x438C3C67BE8D0224, 0x9CC7D7C69CD777B6, 0xA09CAEBF594F0BA0]


@settings(max_examples=50)
@given(seed=st.integers(0, MASK), packet=st.integers(0, 2**62), draw=st.integers(0, 2**40),
       place=st.integers(0, 50), direction=st.integers(0, 1))
def test_words_are_philox_of_seed_direction_place_packet_draw(
        seed: int, packet: int, draw: int, place: int, direction: int) -> None:
    words = Rng(seed, direction, place).words(np.array([packet]), draw)[0].tolist()
    lane = 2 * place + direction
    assert words == philox_4x64_10([packet + 1, draw, lane, 0], [seed, KEY])
    numpys = Philox(key=np.array([seed, KEY], np.uint64), counter=np.array([packet, draw, lane, 0], np.uint64))
    assert words == numpys.random_raw(4).tolist()


@settings(max_examples=50)
@given(packets=st.lists(st.one_of(st.integers(0, 5000), st.integers(0, 2**61)), max_size=40))
def test_a_draw_does_not_depend_on_what_it_is_drawn_with(packets: list[int]) -> None:
    together = Rng(3, 0, 1).words(np.array(packets, np.int64))
    assert together.shape == (len(packets), 4)
    kept = Rng(3, 0, 1)
    for packet, row in zip(packets, together, strict=True):
        assert np.array_equal(kept.words(np.array([packet]))[0], row)


def test_a_long_run_equals_its_packets_one_by_one() -> None:
    run = np.arange(BLOCK - 100, 2 * BLOCK + 100)
    whole = Rng(9, 1, 2).uniform(run, draw=5, word=2)
    kept = Rng(9, 1, 2)
    some = np.r_[0:200, len(run) - 200:len(run)]  # about both borders of a block
    assert whole[some].tolist() == [float(kept.uniform(run[i:i + 1], draw=5, word=2)[0]) for i in some]
    assert np.array_equal(Rng(9, 1, 2).uniform(run[::-1], draw=5, word=2), whole[::-1])


def test_uniform_numbers_are_numpys_of_the_same_53_bits_and_stay_within_their_ends() -> None:
    ours = Rng(4, 0, 0).words(np.arange(50))
    theirs = Generator(Philox(key=[4, KEY], counter=[0, 0, 0, 0])).random(200)
    assert unit(ours).ravel().tolist() == theirs.tolist()
    extremes = np.array([0, MASK], np.uint64)
    assert unit(extremes).tolist() == [0.0, 1.0 - 2.0**-53]
    assert inside(extremes).tolist() == [2.0**-53, 1.0 - 2.0**-53]
