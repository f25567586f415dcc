"""The texture network and its settings."""

from dataclasses import dataclass

import torch
from torch import nn

from bumpymap.core import TEXTURES

__all__ = ["NetworkSettings", "TextureNet"]


@dataclass(frozen=True, slots=True)
class NetworkSettings:
    """Architecture of the network."""

    pixels: int = 15
    """Pixels along a side of a patch, at least 9."""
    channels: tuple[int, int, int, int] = (16, 32, 64, 96)
    """Filters of the four convolutions."""
    hidden: int = 128
    """Units of the hidden layer between the averages over the patch and the output."""
    classes: tuple[str, ...] = TEXTURES


class TextureNet(nn.Module):
    """Four 3 x 3 convolutions, the last two at half resolution, an average over the patch, and two dense layers.

    There is no padding before the pooling, because the network would read a border of zeros as low ground. The last
    convolution pads only if a patch has fewer than 11 pixels.
    """

    def __init__(self, settings: NetworkSettings) -> None:
        super().__init__()
        self.settings = settings
        a, b, c, d = settings.channels
        self.conv1, self.norm1 = nn.Conv2d(1, a, 3, bias=False), nn.BatchNorm2d(a)
        self.conv2, self.norm2 = nn.Conv2d(a, b, 3, bias=False), nn.BatchNorm2d(b)
        self.pool = nn.MaxPool2d(3, stride=2)
        self.conv3, self.norm3 = nn.Conv2d(b, c, 3, padding=1, bias=False), nn.BatchNorm2d(c)
        border = int(settings.pixels < 11)
        self.conv4, self.norm4 = nn.Conv2d(c, d, 3, padding=border, bias=False), nn.BatchNorm2d(d)
        self.conv5, self.norm5 = nn.Conv2d(d, settings.hidden, 1, bias=False), nn.BatchNorm2d(settings.hidden)
        self.head = nn.Conv2d(settings.hidden, len(settings.classes), 1)

    def forward(self, patches: torch.Tensor) -> torch.Tensor:
        """Return logits (n, classes) of patches (n, 1, pixels, pixels) scaled to [0, 1]."""
        x = torch.relu(self.norm1(self.conv1(patches)))  # (n, 16, 13, 13)
        x = torch.relu(self.norm2(self.conv2(x)))  # (n, 32, 11, 11)
        x = torch.relu(self.norm3(self.conv3(self.pool(x))))  # (n, 64, 5, 5)
        x = torch.relu(self.norm4(self.conv4(x)))  # (n, 96, 3, 3)
        x = x.mean(dim=(2, 3), keepdim=True)  # (n, 96, 1, 1)
        x = torch.relu(self.norm5(self.conv5(x)))  # (n, 128, 1, 1)
        return self.head(x).flatten(1)  # (n, 4)

    def parameter_count(self) -> int:
        """Return the number of trained parameters."""
        return sum(p.numel() for p in self.parameters())
