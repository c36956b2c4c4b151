"""Shape that the summary of a run must have for a table to be made of it, whoever wrote it."""

from __future__ import annotations

from dataclasses import fields

from teleop.scene.axes import SHAPES
from teleop.scene.scene import MOST_TICKS
from teleop.simulation.plan import Packets
from teleop.storage.strict_json import (
    Check,
    Misshapen,
    between,
    dict_of,
    either,
    list_of,
    one_of,
    optional,
    real,
    record,
    text,
    whole,
)

MOST_SEED = (1 << 64) - 1
TICK = whole(low=-1, high=MOST_TICKS)
COUNT = whole(low=0)
EVENT = record({"k": TICK, "what": text, "why": text})
_ESTIMATE = either(real, one_of("inf", "-inf", "nan"))  # of a run that diverged, see `strict_json.json_text`
_TIMES = record({"mean": real})
_COUNTS: dict[str, Check] = {each.name: COUNT for each in fields(Packets)} | {"rejected": dict_of(COUNT)}


def packets(value: object, name: str) -> None:
    """The counts of one direction."""
    record({}, _COUNTS)(value, name)
    unknown = next((key for key in value if key not in _COUNTS), None)  # type: ignore[attr-defined]  # an object
    if unknown is not None:
        raise Misshapen(f"{name} has {unknown[:40]!r}, which is no count of packets")


def end(value: object, name: str) -> None:
    """Summary of one end of a live run."""
    record({}, {
        "status": text, "sentence": text, "ticks": COUNT, "skipped": whole(), "events": optional(list_of(EVENT)),
        "late_us": optional(dict_of(real)), "cpu": optional(real), "run_time": optional(real), "rtt": optional(_TIMES),
        "jitter": real, "lost": whole(), "reordered": whole(),
        "peer_clock": optional(record({}, {"drift": optional(real)})), "realtime": optional(dict_of(text)),
    })(value, name)
    if isinstance(value, dict) and value.get("rtt"):
        record({"jitter": real, "lost": whole(), "reordered": whole()})(value, name)


def of_end(name: str, *ways: str) -> Check:
    """The summary of the run of one end, "master" or "slave", with the counts of the directions `ways`."""
    return record({name: end, "packets": record(dict.fromkeys(ways, packets))})


RUN = record({
    "status": text, "sentence": text, "scene": text, "mode": text, "seed": whole(low=0, high=MOST_SEED),
    "parameters": record({}, {"law": either(text, record({"name": text}))}),
    "dt": between(1e-6, 10.0), "ticks": whole(low=0, high=MOST_TICKS), "run_time": optional(real),
    "metrics": dict_of(record({"value": real})), "packets": dict_of(packets), "notes": list_of(text),
}, {
    "versions": dict_of(text), "command": list_of(text), "end": one_of("master", "slave"), "master": end, "slave": end,
    "bodies": text, **SHAPES,
    "integration": optional(dict_of(record({
        "error_estimate_max": _ESTIMATE, "error_estimate_sum": _ESTIMATE, "substeps_max": real,
        "ticks_over_tolerance": real, "tolerance": real,
    }))),
})
