"""CITATION.cff: it parses, says what pyproject.toml says, and names the paper of each law as that law's file does."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import yaml

from teleop.law import BUILT_IN
from teleop.version import DISTRIBUTION, __version__

ROOT = Path(__file__).resolve().parent.parent
CITED: dict[str, Any] = yaml.safe_load((ROOT / "CITATION.cff").read_text())
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
BESIDE = {"authors", "type", "title", "journal", "collection-title", "volume", "issue", "year", "doi", "notes"}


def laws(paper: dict[str, Any]) -> list[str]:
    return [name.strip() for name in paper["notes"].split(",")]


def head(law: str) -> str:
    """What stands before the code of a law's file, in one line."""
    return " ".join((ROOT / "teleop" / "laws" / f"{law}.py").read_text().split('"""')[1].split())


def test_it_has_what_version_1_2_of_the_format_asks_for() -> None:
    assert CITED["cff-version"] == "1.2.0"
    assert CITED["message"]
    assert CITED["type"] == "software"
    assert [sorted(author) for author in CITED["authors"]] == [["name"]]


def test_it_says_what_the_package_and_its_licence_say() -> None:
    assert CITED["title"] == DISTRIBUTION == PROJECT["name"]
    assert str(CITED["version"]) == __version__
    assert CITED["license"] == PROJECT["license"]
    assert CITED["keywords"] == PROJECT["keywords"]
    assert CITED["abstract"] == PROJECT["description"]
    author, = (author["name"] for author in CITED["authors"])
    assert author.lower() in (ROOT / "LICENSE").read_text().lower()


def test_every_law_has_its_paper() -> None:
    assert {law for paper in CITED["references"] for law in laws(paper)} == set(BUILT_IN)


def test_a_paper_is_that_of_the_law_as_its_own_file_has_it() -> None:
    for paper in CITED["references"]:
        assert set(paper) <= BESIDE
        for law in laws(paper):
            text = head(law).lower()
            assert paper["title"].lower() in text, law
            assert str(paper["year"]) in text, law
            for author in paper["authors"]:
                assert author["family-names"].replace("ñ", "n").lower() in text, law
            if "issue" in paper:
                assert f"{paper['volume']}({paper['issue']})" in text, law
