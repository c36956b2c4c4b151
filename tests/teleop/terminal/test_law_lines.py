"""What `teleop list` says of laws: what they send, what they claim on which condition, the energy they begin with."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import pytest

from teleop import At, find_law, kind, seed_energy
from teleop.law import BUILT_IN
from teleop.terminal.listing import law_line, law_words
from tests.teleop.conftest import Answer

Typed = Callable[..., Answer]
TWO_PORTS = sorted(name for name in BUILT_IN if hasattr(find_law(name), "master"))


class Forth(NamedTuple):
    u: kind.Wave
    E: kind.Total
    x: float


@dataclass(frozen=True, kw_only=True)
class Mine:
    """Nothing but a shape."""

    E0: float = 0.03
    claims: ClassVar[Mapping[str, str]] = {"E_link": "zero in gaps", "E_law": "constant delay"}

    def master_start(self, at: At) -> Any:
        return (), Forth(0.0, 0.0, at.x)

    def slave_start(self, at: At) -> Any:
        return (), Forth(0.0, 0.0, at.x)

    def master(self, s: Any, at: At, rx: Forth) -> Any:
        return 0.0, Forth(0.0, 0.0, at.x), s

    def slave(self, s: Any, at: At, rx: Forth) -> Any:
        return 0.0, Forth(0.0, 0.0, at.x), s

    def master_stored(self, s: Any) -> float:
        return self.E0

    def slave_stored(self, s: Any) -> float:
        return 0.0

    def conditions(self, facts: Any) -> tuple[str, ...]:
        return ("it asks for less loss",) if facts.lossy else ()


def test_a_line_has_kinds_of_fields_conditions_of_claims_and_the_energy_at_the_start() -> None:
    said = law_line(Mine())
    assert said is not None
    assert (said.fwd, said.bwd) == ("wave u, total E, x", "wave u, total E, x")
    assert said.claimed == "E_link with zero in gaps, E_law over constant delay"
    assert said.seed == 0.03


def test_the_words_on_one_law_have_its_conditions_over_links_that_break_them() -> None:
    lines, document = law_words(Mine)
    told = "\n".join(lines)
    assert "claims E_link >= 0 over every link, with waves played as zero in gaps" in told
    assert "claims E_law >= 0 over a constant delay without loss" in told
    assert "30.0 mJ to begin with" in told
    assert "over a constant 50 ms" not in told
    assert "50 to 70 ms each way with 5 % loss, in the scene canonical: it asks for less loss" in told
    assert document["conditions"]["a constant 50 ms each way"] == []


def test_a_law_that_has_to_be_given_a_number_is_known_by_its_knobs_alone() -> None:
    @dataclass(frozen=True, kw_only=True)
    class Needs(Mine):
        K: float

    assert law_words(Needs) == ([], {})


def test_the_table_has_a_line_for_each_of_at_least_fifteen_laws_with_two_ports(typed: Typed) -> None:
    rows = {row["name"]: row for row in json.loads(typed("list", "laws", "--json").out)["laws"]}
    assert set(rows) == set(BUILT_IN)
    assert len(TWO_PORTS) >= 15
    for name in TWO_PORTS:
        row, law = rows[name], find_law(name)()
        assert row["fwd"]
        assert row["bwd"]
        assert all(ledger in row["claims"] for ledger in law.claims)
        assert (row["claims"] == "nothing") == (not law.claims)
        assert (row["seed_energy"] is None) == (not hasattr(law, "master_stored"))
        assert len(row["meaning"]) > 10
    assert rows["virtual_wall"]["fwd"] == "(one port)"
    assert rows["wave"]["claims"] == "E_link over any link"


@pytest.mark.parametrize("name", ["wave", "tdpa"])
def test_of_one_law_the_claims_stand_below_its_knobs(name: str, typed: Typed) -> None:
    knobs, words = typed("list", name).out.split("\n\n")
    assert knobs.startswith(f"law {name}: ")
    law = find_law(name)()
    assert [line.split()[1] for line in words.splitlines() if line.startswith("  claims")] == list(law.claims)
    document = json.loads(typed("list", name, "--json").out)["found"][0]
    assert document["claims"] == dict(law.claims)
    assert document["seed_energy"] == (seed_energy(law) if hasattr(law, "master_stored") else None)


def test_of_a_file_of_ones_own_too(typed: Typed, tmp_path: Path) -> None:
    source = Path(__file__).read_text().partition("class Forth")[2].partition("\n\ndef test_")[0]
    head = "from __future__ import annotations\n" + "\n".join([
        "from collections.abc import Mapping", "from dataclasses import dataclass",
        "from typing import Any, ClassVar, NamedTuple", "from teleop import At, kind"])
    (tmp_path / "mine.py").write_text(f"{head}\n\nclass Forth{source}\n")
    assert "sends fwd wave u, total E, x" in typed("list", "mine.py").out
