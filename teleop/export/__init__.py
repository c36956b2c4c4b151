"""Runs for other tools: MCAP for Foxglove, CSV for pandas, UDP for PlotJuggler; the manifest for another language."""
