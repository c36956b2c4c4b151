"""One file is one velocity estimator of a haptic device: what it computes, its source and its error."""
