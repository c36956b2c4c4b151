"""One file is one law: both its ends, its messages, its source and what it claims about passivity."""
