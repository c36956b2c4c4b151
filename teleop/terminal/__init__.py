"""The terminal: options, tables, progress lines, and figures."""
