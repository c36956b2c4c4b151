"""Laws, one file each: both ends, the messages, the source, and the claims about passivity."""
