"""Diagrams of a session's states, for the README of the protocol: `python -m tests.teleop.protocol.diagrams`."""

from __future__ import annotations

from teleop.protocol.states import MASTER, SLAVE, SessionEvent, SessionState, Table


def diagram(table: Table, first: SessionState) -> str:
    """The table as a state diagram in mermaid's language; events between the same two states share one arrow."""
    arrows: dict[tuple[str, str], list[str]] = {}
    for (state, event), then in table.items():
        arrows.setdefault((state.name, then.name), []).append(event.name)
    lines = [f"    {state} --> {then}: {', '.join(events)}" for (state, then), events in arrows.items()]
    named = dict.fromkeys([first, *[state for pair in table for state in (pair[0], table[pair])]])
    legend = [f"    {state.name}: {state.name}\\n{state.value}" for state in named]
    return "\n".join(["```mermaid", "stateDiagram-v2", *legend, f"    [*] --> {first.name}", *lines, "```"])


def diagrams() -> str:
    """Both diagrams and the list of events, as they stand in the README of this folder."""
    events = "\n".join(f"- `{event.name}`: {event.value}" for event in SessionEvent)
    return (f"### The master's session\n\n{diagram(MASTER, SessionState.ASKING)}\n\n"
            f"### The slave's session\n\n{diagram(SLAVE, SessionState.LISTENING)}\n\n### Events\n\n{events}\n")


if __name__ == "__main__":
    print(diagrams(), end="")
