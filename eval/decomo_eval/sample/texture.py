"""Procedural textures: overlapping leaves of all sizes, spots and stripes, each lit by noise of every scale.

Leaves of power-law sizes that cover one another ("dead leaves") and noise that falls with frequency both give the 1/f
amplitude spectrum of natural images; the noise leaves no place without texture.
"""

from __future__ import annotations

import colorsys
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.float32]

SUBPIXEL_BITS = 4
"""OpenCV's drawing functions take fixed-point coordinates."""
GRAIN = 1024
"""Texels of a grain's side."""
GRAIN_CONTRAST = 0.07
"""Of one octave of light: about the share that it has in `roughen`."""


@dataclass(frozen=True)
class Grain:
    """Light on a layer that is finer than its colours' raster: a square that repeats."""

    light: Image
    """[R, R], factor of the colours."""
    extent: float
    """Material coordinates from one repetition to the next."""

    def at(self, uv: npt.NDArray[np.float64]) -> Image:
        """Factors [H, W] at material [H, W, 2]."""
        texel = (uv * (len(self.light) / self.extent)).astype(np.float32)
        light = cv2.remap(self.light, texel[..., 0], texel[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        return light.astype(np.float32, copy=False)


@dataclass(frozen=True)
class Texture:
    """Colours of a layer over the square of material coordinates from -extent to +extent."""

    image: Image
    """[R, R, 3], RGB in 0..1; row along v, column along u."""
    extent: float
    grain: Grain | None = None

    def at(self, uv: npt.NDArray[np.float64]) -> Image:
        """Colours [H, W, 3] at material [H, W, 2], bilinear; beyond the square the texture is mirrored."""
        texel = ((uv / self.extent + 1) * (len(self.image) / 2) - 0.5).astype(np.float32)
        columns, rows = texel[..., 0], texel[..., 1]
        colours = cv2.remap(self.image, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        colours = colours.astype(np.float32, copy=False)
        return colours if self.grain is None else colours * self.grain.at(uv)[..., None]


def natural_noise(rng: np.random.Generator, resolution: int, coarsest: float, finest: float, falloff: float) -> Image:
    """Noise [R, R] of mean 0 and deviation 1 whose amplitude falls as frequency^-falloff; 1 is that of natural images.

    Frequencies from `coarsest` to `finest` cycles across the texture, the same strength in every direction.
    """
    grid = 2 * round(2 * finest)
    spectrum = np.fft.rfft2(rng.standard_normal((grid, grid)))
    frequency = np.hypot(np.fft.fftfreq(grid, 1 / grid)[:, None], np.fft.rfftfreq(grid, 1 / grid))
    shape = np.where((frequency >= coarsest) & (frequency <= finest), np.maximum(frequency, 1) ** -falloff, 0)
    noise = np.fft.irfft2(spectrum * shape, (grid, grid))
    noise = (noise / noise.std()).astype(np.float32)
    return cv2.resize(noise, (resolution, resolution), interpolation=cv2.INTER_CUBIC).astype(np.float32, copy=False)


def draw_palette(rng: np.random.Generator, hue: float, spread: float, saturation: tuple[float, float]) -> Image:
    """Six colours [6, 3] from dark to bright around `hue` (0..1)."""
    return np.array(
        [
            colorsys.hsv_to_rgb((hue + rng.uniform(-spread, spread)) % 1, rng.uniform(*saturation), value)
            for value in np.linspace(0.25, 0.85, 6) + rng.uniform(-0.05, 0.05, 6)
        ],
        np.float32,
    )


def paint_leaves(
    rng: np.random.Generator, ground: Image, palette: Image, count: int, sizes: tuple[float, float]
) -> Image:
    """Ellipses and polygons over `ground` [R, R, 3], later ones on top; `sizes` are radii in fractions of the texture.

    Radii follow a density of r^-3 between the two sizes.
    """
    canvas = np.round(np.clip(ground, 0, 1) * 255).astype(np.uint8)
    fixed = len(canvas) << SUBPIXEL_BITS
    smallest, largest = sizes
    radii = 1 / np.sqrt(rng.uniform(largest**-2, smallest**-2, count))
    for radius in radii:
        outline = radius * _draw_leaf(rng) + rng.uniform(-0.02, 1.02, 2)
        colour = np.clip(palette[rng.integers(len(palette))] * rng.uniform(0.75, 1.25), 0, 1) * 255
        polygon = np.round(outline * fixed).astype(np.int32)
        cv2.fillPoly(canvas, [polygon], colour.tolist(), cv2.LINE_AA, SUBPIXEL_BITS)
    return np.asarray(canvas, np.float32) / np.float32(255)


def _draw_leaf(rng: np.random.Generator) -> npt.NDArray[np.float64]:
    """Corners [C, 2] of a turned ellipse of longer half-axis 1, or of a polygon inscribed in one."""
    if rng.random() < 0.5:
        angles = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(3, 8)))
    else:
        angles = np.linspace(0, 2 * np.pi, 32, endpoint=False)
    shape = np.stack([np.cos(angles), rng.uniform(0.45, 1.0) * np.sin(angles)], axis=-1)
    turn = rng.uniform(0, 2 * np.pi)
    return shape @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])


def paint_stripes(rng: np.random.Generator, resolution: int, palette: Image, bands: float) -> Image:
    """Uneven bands [R, R, 3] of two colours of the palette, bent by noise so that none is straight."""
    row, column = np.mgrid[0:resolution, 0:resolution].astype(np.float32) / np.float32(resolution)
    turn = rng.uniform(0, np.pi)
    along = np.cos(turn) * column + np.sin(turn) * row
    bent = along * bands + 0.45 * natural_noise(rng, resolution, 2, 8, 2.0)
    share = 0.5 + 0.5 * np.tanh(4 * np.sin(2 * np.pi * bent))[..., None]
    dark, bright = palette[rng.integers(0, 2)], palette[rng.integers(4, 6)]
    return np.asarray(dark * (1 - share) + bright * share, np.float32)


def roughen(rng: np.random.Generator, colours: Image, finest: float, contrast: float) -> Image:
    """`colours` [R, R, 3] lit by noise up to `finest` cycles across, with a fainter tint of its own in each channel."""
    resolution = len(colours)
    light = natural_noise(rng, resolution, 3, finest, 1.05)[..., None]
    tint = np.stack([natural_noise(rng, resolution, 2, finest / 4, 1.0) for _ in range(3)], axis=-1)
    return np.clip(colours * np.exp(contrast * light + 0.06 * tint), 0.02, 0.98).astype(np.float32)


def draw_grain(rng: np.random.Generator, pixel: float, octaves: float) -> Grain:
    """The finest `octaves` of a texture that is seen at `pixel` material units to a pixel, down to three pixels a
    cycle; as strong in each as `roughen` makes the others.
    """
    finest = GRAIN / 4
    noise = natural_noise(rng, GRAIN, finest * 2**-octaves, finest, 1.0)
    return Grain(np.exp(GRAIN_CONTRAST * octaves**0.5 * noise), 3 * finest * pixel)


def draw_ground(rng: np.random.Generator, resolution: int, extent: float, finest: float, hue: float) -> Texture:
    """The background's texture: muted, with structures from a few pixels to a quarter of the frame."""
    palette = draw_palette(rng, hue, 0.12, (0.08, 0.35))
    blank = np.broadcast_to(palette[2], (resolution, resolution, 3))
    leaves = paint_leaves(rng, blank, palette, 1600, (0.008, 0.16))
    return Texture(roughen(rng, leaves, finest, 0.2), extent)


def draw_skin(rng: np.random.Generator, resolution: int, extent: float, finest: float, hue: float) -> Texture:
    """An object's texture: more colourful than the background; leaves, spots or stripes."""
    palette = draw_palette(rng, hue, 0.07, (0.35, 0.7))
    plain = np.broadcast_to(palette[rng.integers(2, 5)], (resolution, resolution, 3))
    kind = rng.integers(3)
    if kind == 0:
        colours = paint_leaves(rng, plain, palette, 350, (0.02, 0.15))
    elif kind == 1:
        colours = paint_leaves(rng, plain, palette, 90, (0.025, 0.06))
    else:
        colours = paint_leaves(
            rng, paint_stripes(rng, resolution, palette, rng.uniform(5, 8)), palette, 30, (0.02, 0.05)
        )
    return Texture(roughen(rng, colours, finest, 0.17), extent)
