"""MV3DCD (Galappaththige et al. 2024): change as a channel of Gaussians."""
