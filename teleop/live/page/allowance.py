"""How much a page may say: 200 messages a second, and not what no page would say."""

from __future__ import annotations

MOST = 200  # messages a second
SECONDS = 5  # that a page may go on beyond it, one after the other
GARBAGE = 20  # messages that are none, and the page is closed


class Allowance:
    """That of one page. Times are in s."""

    def __init__(self) -> None:
        self.dropped = 0  # messages beyond `MOST`
        self._since: float | None = None  # when this second began
        self._count = 0  # in this second
        self._beyond = 0  # seconds, one after the other, in which there were too many
        self._kinds: set[str] = set()  # of garbage
        self._garbage = 0

    def takes(self, now: float) -> bool:
        """Is there room for one more message?"""
        if self._since is None or now - self._since >= 1.0:
            follows = self._since is not None and now - self._since < 2.0
            self._beyond = self._beyond + 1 if follows and self._count > MOST else 0
            self._since, self._count = now, 0
        self._count += 1
        if self._count > MOST:
            self.dropped += 1
            return False
        return True

    @property
    def begins(self) -> bool:
        """True of the first message of a second that there is no room for, where the second before had room for all."""
        return self._count == MOST + 1 and self._beyond == 0

    @property
    def floods(self) -> bool:
        """True of a page that has gone on for `SECONDS`."""
        return self._beyond >= SECONDS

    def garbage(self, kind: str) -> bool:
        """Count a message that is none; True if it is the first of its kind."""
        self._garbage += 1
        first = kind not in self._kinds
        self._kinds.add(kind)
        return first

    @property
    def talks_nonsense(self) -> bool:
        """True of a page that has sent too much garbage."""
        return self._garbage >= GARBAGE
