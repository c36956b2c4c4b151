"""Studies: many laws, links and environments side by side, through sweeps and analyses."""
