"""A convex region of the quarter plane K, B >= 0 that is known by how far out a point lies."""

from __future__ import annotations

from collections.abc import Callable

Point = tuple[float, float]  # (K, B)
Gauge = Callable[[float, float], tuple[float, Point]]  # how far out a point is, 1 on the boundary, and the gradient

CLOSE = 3e-5  # of the distance from (0, 0): how far the polygon may lie inside the region
ROUNDS = 12  # each makes a curved side at least four times as close
STRAIGHT = 1e-8  # a turn that is less is none
FAR = 1e3  # of the intercepts: nothing passive lies beyond


def polygon(gauge: Gauge, close: float = CLOSE) -> list[Point]:
    """The corners but (0, 0) of the region where a convex gauge that is homogeneous of degree one is at most 1.

    By cutting planes: a corner that lies outside is cut off along the gradient there, until none does by more than
    `close`. What is left encloses the region; each corner is then drawn back onto its boundary.
    """
    most_K, most_B = 1.0 / gauge(1.0, 0.0)[0], 1.0 / gauge(0.0, 1.0)[0]
    corners = [(0.0, 0.0), (FAR * most_K, 0.0), (FAR * most_K, FAR * most_B), (0.0, FAR * most_B)]
    levels: dict[Point, float] = {(0.0, 0.0): 0.0}
    for _ in range(ROUNDS):  # all corners in turn, so that no side is finer than another
        asked = {corner: gauge(*corner) for corner in corners if corner not in levels}
        for corner, (value, gradient) in asked.items():
            levels[corner] = value
            if value > 1.0 + close:
                corners = clip(corners, gradient)
        if not asked:
            break
    found = [(K / level, B / level) for K, B in corners[1:] for level in [levels.get((K, B)) or gauge(K, B)[0]]]

    def straight(a: Point, b: Point, c: Point) -> bool:
        turn = (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0])
        return abs(turn) < STRAIGHT * most_K * most_B

    kept = found[:1]
    for i, corner in enumerate(found[1:-1], 1):
        if not straight(kept[-1], corner, found[i + 1]):
            kept.append(corner)
    return [*kept, found[-1]]


def clip(corners: list[Point], line: tuple[float, ...]) -> list[Point]:
    """The part of a convex polygon in which line[0] K + line[1] B <= 1; the first corner, (0, 0), stays the first."""
    depth = [1.0 - line[0] * K - line[1] * B for K, B in corners]
    found: list[Point] = []
    for i, (here, now) in enumerate(zip(corners, depth, strict=True)):
        j = (i + 1) % len(corners)
        if now >= 0.0:
            found.append(here)
        if (now > 0.0 > depth[j]) or (now < 0.0 < depth[j]):
            part = now / (now - depth[j])
            there = corners[j]
            found.append((here[0] + part * (there[0] - here[0]), here[1] + part * (there[1] - here[1])))
    return found
