"""3DGS-CD (Lu et al. 2024): changed things by comparing captured with rendered pictures."""
