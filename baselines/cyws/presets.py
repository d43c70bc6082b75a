"""Networks by name: the published ones, and small ones for ordinary computers."""

from dataclasses import dataclass
from typing import Literal

from torch import nn

from baselines.cyws.networks import Cyws2D, Cyws3D, Cyws3DDino
from baselines.cyws.resnet import ResNet

Dimension = Literal["2d", "3d"]
Architecture = Literal[
    "cyws2d-resnet50", "cyws2d-resnet18", "cyws2d-small", "cyws3d-dino", "cyws3d-small"
]


@dataclass(frozen=True)
class Preset:
    """A network and the size of pictures that it takes."""

    architecture: Architecture
    height: int
    width: int
    """Of the network's input, in pixels: pictures are resized, whatever their aspect."""
    channels: int = 64
    """Of the encoder's first level, where it can be chosen."""

    def build(self, *, bias: bool = False) -> nn.Module:
        """The network with random weights.

        Parameters
        ----------
        bias : bool
            See `networks.Cyws3DDino`.
        """
        w = self.channels
        shallow = (2, 2, 2, 2)
        match self.architecture:
            case "cyws2d-resnet50":
                return Cyws2D(ResNet((3, 4, 6, 3), w, bottleneck=True))
            case "cyws2d-resnet18":
                return Cyws2D(ResNet(shallow, w), hidden=(128, 64, 32))
            case "cyws2d-small":
                widths, hidden = (4 * w, 4 * w, 2 * w, 2 * w), (4 * w,) * 4
                encoder = ResNet(shallow, w)
                return Cyws2D(encoder, widths, hidden, imagenet=True, subtract=True)
            case "cyws3d-dino":
                return Cyws3DDino(bias=bias)
            case "cyws3d-small":
                return Cyws3D(ResNet(shallow, w), (4 * w, 4 * w, 2 * w, 2 * w))


PRESETS: dict[Architecture, Preset] = {
    "cyws2d-resnet50": Preset("cyws2d-resnet50", 256, 256),
    "cyws2d-resnet18": Preset("cyws2d-resnet18", 256, 256),
    "cyws2d-small": Preset("cyws2d-small", 128, 160, 16),
    "cyws3d-dino": Preset("cyws3d-dino", 224, 224),
    "cyws3d-small": Preset("cyws3d-small", 128, 160, 16),
}
