"""Drivers of the arms that labs have, one file each, on their vendors' or the ecosystem's own libraries."""
