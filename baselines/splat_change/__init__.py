"""What 3DGS-CD and MV3DCD share: models of both captures, seen from each other's cameras."""
