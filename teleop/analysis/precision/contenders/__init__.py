"""Contenders: the methods whose precision is compared."""
