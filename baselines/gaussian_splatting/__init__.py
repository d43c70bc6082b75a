"""3D Gaussian splatting on any CPU, or on CUDA through `gsplat`."""
