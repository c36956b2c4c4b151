"""Docstrings as the reference shows them: an extension of griffe, which reads the sources."""

from __future__ import annotations

import re
from typing import Any

from griffe import Docstring, Extension, Object

EXAMPLE = re.compile(r"(?:^[ ]*>>>.*\n?(?:^[ ]*\S.*\n?)*)+", re.MULTILINE)


class Docstrings(Extension):
    """Fence examples, from >>> to the next empty line; take the comment behind a field for its docstring."""

    def on_object(self, *, obj: Object, **_: Any) -> None:
        """Change the docstring of one object."""
        if obj.docstring is not None:
            text = obj.docstring.value
            obj.docstring.value = EXAMPLE.sub(lambda match: f"```python\n{match[0].rstrip()}\n```\n", text)
        elif obj.is_attribute:
            _, _, comment = obj.source.partition("  # ")
            if comment and not comment.startswith(("type:", "noqa")):
                obj.docstring = Docstring(comment.strip(), parent=obj)
