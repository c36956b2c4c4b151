"""Tuning: the parameters of one law for one scene, by a stated search with a stated number of rows."""
