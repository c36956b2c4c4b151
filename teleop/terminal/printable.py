"""Text on its way to a terminal, which obeys some characters: what files, peers and names hold must not order it."""

from __future__ import annotations


def printable(text: str, *, lines: bool = False, most: int = 4000) -> str:
    r"""`text` on one line, with at most `most` characters, and what a terminal would obey written out.

    That is whatever `str.isprintable` does not count in: control and escape characters, changes of the direction of
    writing, halves of characters, line ends. With `lines` the line ends stay and the length is not bounded.

    >>> print(printable("a\x1b[2Jb\u202ec\nd"))
    a\x1b[2Jb\u202ec\nd
    """
    if not lines and len(text) > most:
        text = f"{text[:most - 3]}..."
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or (lines and c == "\n") else c.encode("unicode_escape").decode()
                   for c in text)
