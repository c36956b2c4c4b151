"""Models that several analyses share: linear loops, frequency responses, margins."""
