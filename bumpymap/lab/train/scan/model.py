"""The network for sectors of a scan, after MobileNetV2, and its settings."""

from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import nn

from bumpymap.core import CLASSES
from bumpymap.scan import CHANNELS, MEASURES

__all__ = ["InvertedResidual", "ScanNet", "ScanNetSettings", "convolution"]


@dataclass(frozen=True, slots=True)
class ScanNetSettings:
    """Architecture of the network."""

    stem: int = 16
    """Filters of the first convolution, which halves the resolution."""
    widths: tuple[int, ...] = (16, 24, 24, 24)
    """Channels after each inverted residual; where they increase, the resolution is halved."""
    expansion: int = 4
    """Expansion factor inside an inverted residual."""
    measure_channels: int = 16
    """Channels of the layer that takes the measures."""
    hidden: int = 48
    """Channels of the last hidden layer."""


def convolution(source: int, target: int, size: int, stride: int = 1, groups: int = 1) -> nn.Sequential:
    """Make a convolution without bias, followed by batch normalisation."""
    return nn.Sequential(
        nn.Conv2d(source, target, size, stride, size // 2, groups=groups, bias=False), nn.BatchNorm2d(target)
    )


class InvertedResidual(nn.Module):
    """Widen by 1 x 1, filter each channel by 3 x 3, narrow by 1 x 1; add the input if the shapes match."""

    def __init__(self, source: int, target: int, stride: int, expansion: int) -> None:
        super().__init__()
        inner = expansion * source
        self.widen = convolution(source, inner, 1)
        self.filter = convolution(inner, inner, 3, stride, groups=inner)
        self.narrow = convolution(inner, target, 1)
        self.adds = stride == 1 and source == target

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Map shape (n, source, h, w) to (n, target, h / stride, w / stride)."""
        inner = nn.functional.relu6(self.widen(x))
        inner = nn.functional.relu6(self.filter(inner))
        narrow: torch.Tensor = self.narrow(inner)
        return x + narrow if self.adds else narrow


class ScanNet(nn.Module):
    """Inverted residuals over the images of a sector; its measures join before the output layer."""

    def __init__(self, settings: ScanNetSettings) -> None:
        super().__init__()
        self.settings = settings
        widths = (settings.stem, *settings.widths)
        self.stem = convolution(CHANNELS, settings.stem, 3, 2)
        self.blocks = nn.ModuleList(
            InvertedResidual(a, b, 2 if b > a else 1, settings.expansion) for a, b in pairwise(widths)
        )
        self.measures = convolution(len(MEASURES), settings.measure_channels, 1)
        self.hidden = convolution(widths[-1] + settings.measure_channels, settings.hidden, 1)
        self.head = nn.Conv2d(settings.hidden, CLASSES, 1)

    def forward(self, patches: torch.Tensor, measures: torch.Tensor) -> torch.Tensor:
        """Return logits (n, CLASSES) of images (n, CHANNELS, pixels, pixels) and measures (n, len(MEASURES))."""
        x = nn.functional.relu6(self.stem(patches))  # (n, 16, 8, 8)
        for block in self.blocks:
            x = block(x)  # (n, 16, 8, 8), then (n, 24, 4, 4) three times
        x = x.mean(dim=(2, 3), keepdim=True)  # (n, 24, 1, 1)
        joined = nn.functional.relu6(self.measures(measures[:, :, None, None]))  # (n, 16, 1, 1)
        x = nn.functional.relu6(self.hidden(torch.cat((x, joined), dim=1)))  # (n, 48, 1, 1)
        logits: torch.Tensor = self.head(x).flatten(1)  # (n, 3)
        return logits

    def parameter_count(self) -> int:
        """Return the number of trained parameters."""
        return sum(p.numel() for p in self.parameters())
