"""The master of a live run as a LeRobot teleoperator: its motion and its force are the action, with their time.

It reads the record that the master's end writes, and opens no device: the run goes on whatever becomes of LeRobot.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lerobot.teleoperators import Teleoperator, TeleoperatorConfig
from lerobot.utils.errors import DeviceNotConnectedError

from teleop import GrowingRun, Refused

MOST = 1 << 16  # rows that are taken at a time


class NewestRow:
    """The newest row of the end `e`, "m" or "s", of the run in `folder`, while its record grows.

    `columns` are the three of each axis that are told, in the order of `SUFFIXES`; units are SI.
    """

    SUFFIXES = (".pos", ".vel", ".force")

    def __init__(self, folder: str, e: str, axes: list[str], force: str) -> None:
        self.e, self.axes, self.columns = e, axes, (f"x_{e}", f"v_{e}", force)
        self.over = False
        self._run = GrowingRun(Path(folder))
        self._state: dict[str, float] | None = None
        self._received = time.monotonic()

    def wait(self, seconds: float) -> bool:
        """Wait for the first row; False: none came."""
        until = time.monotonic() + seconds
        while self.read() is None and time.monotonic() < until:
            time.sleep(0.01)
        return self._state is not None

    def read(self) -> dict[str, float] | None:
        """State by its newest row; None: there is no row yet."""
        row = None
        while not self._run.over and (some := self._run.take(MOST)):
            for each in some:
                if each.end.header["end"] == self.e:
                    row = each
        self.over = self._run.over
        if row is not None:
            self._state, self._received = self._of(row.end, row.rows[-1], row.shift_ns), time.monotonic()
        return self._state

    @property
    def silence(self) -> float:
        """Seconds since a row came."""
        return time.monotonic() - self._received

    def close(self) -> None:
        """Let go of the records."""
        self._run.close()

    def _of(self, end: Any, row: tuple[float, ...], shift_ns: int) -> dict[str, float]:
        at, values = 3, {}  # behind the tick, its lateness and the packet played
        for one in end.fields:
            values[one.name] = row[at : at + one.axes]
            at += one.axes
        missing = [name for name in self.columns if name not in values]
        if missing:
            raise Refused(f"the run records no {missing[0]}; give another force, one of {', '.join(values)}")
        if len(values[self.columns[0]]) != len(self.axes):
            raise Refused(f"the run has {len(values[self.columns[0]])} axes, and {len(self.axes)} are named: "
                          f"{', '.join(self.axes)}; name each in axes")
        out = {axis + suffix: values[name][i] for i, axis in enumerate(self.axes)
               for suffix, name in zip(self.SUFFIXES, self.columns, strict=True)}
        whole, rest = divmod(int(row[0]) * end.header["dt_ns"] + shift_ns, 10**9)
        return {**out, "time.whole": float(whole), "time.rest": rest / 1e9}


def features(axes: list[str]) -> dict[str, type]:
    """The names of what `NewestRow` tells. The time is in two parts, for LeRobot stores single precision."""
    return {**{axis + suffix: float for axis in axes for suffix in NewestRow.SUFFIXES},
            "time.whole": float, "time.rest": float}


@TeleoperatorConfig.register_subclass("bilateral")
@dataclass(kw_only=True)
class BilateralTeleoperatorConfig(TeleoperatorConfig):  # type: ignore[misc]  # LeRobot need not be installed
    """`--teleop.type=bilateral --teleop.run=FOLDER`."""

    run: str  # the folder that the master's end, or a demo, writes
    axes: list[str] = field(default_factory=lambda: ["x"])  # a name for each
    force: str = "f_m"  # N: of the stack against the hand; f_h: of the hand, where its device senses it
    patience: float = 5.0  # s without a row, after which it counts as gone


class BilateralTeleoperator(Teleoperator):  # type: ignore[misc]  # as above
    """The master's end. Its action is where the hand is, how fast, the force, and the time of that tick."""

    config_class = BilateralTeleoperatorConfig
    name = "bilateral"

    def __init__(self, config: BilateralTeleoperatorConfig) -> None:
        super().__init__(config)
        self.config = config
        self._newest: NewestRow | None = None

    @property
    def action_features(self) -> dict[str, type]:
        return features(self.config.axes)

    @property
    def feedback_features(self) -> dict[str, type]:
        return {}  # the hand feels the slave by the run itself

    @property
    def is_connected(self) -> bool:
        return self._newest is not None

    @property
    def is_calibrated(self) -> bool:
        return True

    def connect(self, calibrate: bool = True) -> None:
        self._newest = following(self.config.run, "m", self.config)

    def calibrate(self) -> None:
        """There is nothing to calibrate."""

    def configure(self) -> None:
        """There is nothing to configure."""

    def get_action(self) -> dict[str, float]:
        return now(self._newest, self.config.patience)

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Nothing is sent: the force on the hand is that of the run's law."""

    def disconnect(self) -> None:
        newest, self._newest = self._newest, None
        if newest is not None:
            newest.close()


def following(run: str, e: str, config: Any) -> NewestRow:
    """The end `e` of `run`, of which a row has come. Raises `DeviceNotConnectedError`."""
    try:
        newest = NewestRow(run, e, config.axes, config.force)
        if newest.wait(config.patience):
            return newest
    except Refused as refused:
        raise DeviceNotConnectedError(str(refused)) from refused
    newest.close()
    raise DeviceNotConnectedError(f"no row of the {'master' if e == 'm' else 'slave'} came to {run} within "
                                  f"{config.patience:g} s; give the folder of a run that goes on")


def now(newest: NewestRow | None, patience: float) -> dict[str, float]:
    """State by the newest row. Raises `DeviceNotConnectedError` once the run is over or silent."""
    state = None if newest is None else newest.read()
    if newest is None or state is None:
        raise DeviceNotConnectedError("it is not connected; call connect() first")
    if newest.over or newest.silence > patience:
        raise DeviceNotConnectedError("the run is over" if newest.over else f"no row came for {patience:g} s")
    return state
