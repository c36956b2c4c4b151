"""Runs for the tools that people have: MCAP for Foxglove, CSV for pandas, UDP for PlotJuggler."""
