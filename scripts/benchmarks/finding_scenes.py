"""Composed photographs of balls whose silhouettes are known: a quick stand-in for a path tracer.

Balls are shaded exactly at the rim (normals, perspective, a mirror's reflection of what lies beside it), and roughly
elsewhere: glossy reflection is a blurred panorama, diffuse light nine harmonics of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import asin, degrees, pi, radians, sin, tan

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, grid_sample, normalize

SUPERSAMPLING = 3
BLURS_DEG = (0.0, 4.0, 10.0, 25.0)
_PANORAMA = 512


@dataclass(frozen=True)
class Composed:
    """image (3, H, W); balls: direction (3,) and radius_deg, and whether it is a mirror, the largest first."""

    image: Tensor
    fov_deg: float
    balls: list[tuple[Tensor, float, bool]]
    about: str


def directions(width: int) -> Tensor:
    """(width / 2, width, 3) of a lat-long picture: (sin phi sin theta, cos theta, -cos phi sin theta)."""
    theta = (torch.arange(width // 2) + 0.5) * 2 * pi / width
    phi = (torch.arange(width) + 0.5) * 2 * pi / width - pi
    theta, phi = torch.meshgrid(theta, phi, indexing="ij")
    return torch.stack([phi.sin() * theta.sin(), theta.cos(), -phi.cos() * theta.sin()], -1)


def looked_up(panorama: Tensor, to: Tensor) -> Tensor:
    """(..., 3) radiance of a lat-long (3, h, 2 h) in directions (..., 3)."""
    x = torch.atan2(to[..., 0], -to[..., 2]) / pi
    y = 2 * torch.acos(to[..., 1].clamp(-1, 1)) / pi - 1
    padded = torch.cat([panorama[..., -1:], panorama, panorama[..., :1]], -1)
    grid = torch.stack([x * panorama.shape[-1] / padded.shape[-1], y], -1).reshape(1, -1, 1, 2)
    got = grid_sample(padded[None], grid, mode="bilinear", padding_mode="border", align_corners=False)
    return got[0, :, :, 0].T.reshape(to.shape)


def blurred(panorama: Tensor, sigma_deg: float) -> Tensor:
    """Roughly, by a Gaussian in texels, wider towards the poles."""
    import cv2

    if sigma_deg == 0:
        return panorama
    sigma = sigma_deg / 360 * panorama.shape[-1]
    pad = panorama.shape[-1] // 4
    rows = np.pad(panorama.permute(1, 2, 0).numpy(), ((pad, pad), (pad, pad), (0, 0)), "edge")
    rows[:, :pad], rows[:, -pad:] = rows[:, -2 * pad : -pad], rows[:, pad : 2 * pad]
    return torch.from_numpy(cv2.GaussianBlur(rows, (0, 0), sigma)[pad:-pad, pad:-pad]).permute(2, 0, 1).contiguous()


def _harmonics(d: Tensor) -> Tensor:
    x, y, z = d.unbind(-1)
    return torch.stack([0.282095 + 0 * x, 0.488603 * y, 0.488603 * z, 0.488603 * x, 1.092548 * x * y,
        1.092548 * y * z, 0.315392 * (3 * z * z - 1), 1.092548 * x * z, 0.546274 * (x * x - y * y)], -1)  # fmt: skip


class Surroundings:
    """A light probe, with a texture in directions, perhaps a table below, perhaps dark towards one side."""

    def __init__(self, probe: Tensor, rng: np.random.Generator, kind: str, dark: bool) -> None:
        """Turn the probe, and draw the textures."""
        self.probe = torch.roll(probe, int(rng.integers(probe.shape[-1])), -1)
        self.probe = self.probe / self.probe.clamp_max(20 * self.probe.median()).mean()
        self.kind = kind
        self.height = float(rng.uniform(1.0, 3.0))
        self.scale = float(np.exp(rng.uniform(np.log(0.05), np.log(0.6))))
        self.pattern = _pattern(rng)
        self.contrast = float(rng.uniform(0.3, 1.0))
        self.plane = torch.from_numpy(rng.uniform(0.1, 1.2, 3).astype(np.float32)) * self.probe.median()
        self.dark = torch.from_numpy(normalized(np.array([rng.normal(), rng.normal(), 0.2]))) if dark else None

    def __call__(self, origin: Tensor, to: Tensor) -> Tensor:
        """Radiance (..., 3) towards `origin` from directions `to`; the ball is at unit radii."""
        light = looked_up(self.probe, to)
        if self.kind == "texture":
            at = torch.stack([torch.atan2(to[..., 0], -to[..., 2]), to[..., 1].clamp(-1, 1).asin()], -1)
            light = light * self._textured(at / (0.3 * self.scale + 0.02))
        if self.kind == "table":
            t = (origin[1] + self.height) / (-to[..., 1]).clamp_min(1e-6)
            at = origin[[0, 2]] + t[..., None] * to[..., [0, 2]]
            lit = self.plane * self._textured(at / (4 * self.scale)) + 0.15 * light
            light = torch.where(((to[..., 1] < 0) & (t < 60))[..., None], lit, light)
        if self.dark is not None:
            light = light * torch.sigmoid(6 * (to @ self.dark.float()) - 1.0)[..., None].clamp_min(1e-3)
        return light

    def _textured(self, at: Tensor) -> Tensor:
        """Between 1 - contrast and 1 + contrast."""
        period = at.remainder(1.0) * 2 - 1
        got = grid_sample(
            self.pattern[None],
            period.reshape(1, -1, 1, 2),
            mode="bilinear",
            padding_mode="reflection",
            align_corners=False,
        )
        return 1 + self.contrast * got[0, :, :, 0].T.reshape(*at.shape[:-1], 3)


def normalized(v: np.ndarray) -> np.ndarray:
    """To unit length."""
    return v / np.linalg.norm(v)


def _pattern(rng: np.random.Generator) -> Tensor:
    """(3, 256, 256) in [-1, 1]: fractal noise, patches with sharp edges, stripes or a checkerboard."""
    import cv2

    n, kind = 256, rng.integers(5)
    y, x = np.mgrid[0:n, 0:n] / n
    if kind == 0:
        total = sum(
            cv2.resize(rng.normal(size=(2**k, 2**k, 3)), (n, n), interpolation=cv2.INTER_CUBIC) / 1.5**k
            for k in range(2, 8)
        )
        pattern = np.tanh(total)
    elif kind in (1, 2):
        pattern = np.zeros((n, n, 3))
        for _ in range(60):
            colour, centre = rng.uniform(-1, 1, 3).tolist(), tuple(int(c) for c in rng.integers(0, n, 2))
            if kind == 1:
                cv2.rectangle(pattern, centre, tuple(int(c + rng.integers(8, 80)) for c in centre), colour, -1)
            else:
                cv2.circle(pattern, centre, int(rng.integers(6, 40)), colour, -1)
    elif kind == 3:
        pattern = np.sign(np.sin(2 * pi * 8 * x) * np.sin(2 * pi * 8 * y))[..., None] * rng.uniform(0.3, 1, 3)
    else:
        pattern = np.sin(2 * pi * (12 * x + 0.7 * np.sin(2 * pi * 2 * y)))[..., None] * rng.uniform(0.3, 1, 3)
    return torch.from_numpy(pattern.astype(np.float32)).permute(2, 0, 1).clamp(-1, 1).contiguous()


def shade(
    normals: Tensor, to_camera: Tensor, panoramas: list[Tensor], rng: np.random.Generator, mirror: bool
) -> Tensor:
    """(..., 3) radiance of a random material, or of a mirror."""
    cosine = (normals * to_camera).sum(-1, keepdim=True)
    reflected = 2 * cosine * normals - to_camera
    if mirror:
        return float(rng.choice([1.0, 0.6])) * looked_up(panoramas[0], reflected)
    d = directions(64)
    area = d[..., 1].square().mul(-1).add(1).clamp_min(0).sqrt() * (2 * pi / 64) ** 2
    small = looked_up(panoramas[1], d)
    coefficients = torch.einsum("hwk,hwc,hw->kc", _harmonics(d), small, area)
    band = torch.tensor([pi] + [2 * pi / 3] * 3 + [pi / 4] * 5)[:, None]
    irradiance = (_harmonics(normals) @ (band * coefficients)).clamp_min(0)
    kind = rng.integers(3)
    albedo = np.exp(rng.uniform(np.log(0.02), np.log(0.9), 3)) * (kind != 2)
    f0 = np.full(3, 0.04) if kind else np.zeros(3) + 0.02
    f0 = rng.uniform(0.3, 0.95, 3) if kind == 2 else f0
    gloss = looked_up(panoramas[int(rng.integers(0 if kind else 1, 4))], reflected)
    f0_, albedo_ = (torch.from_numpy(v.astype(np.float32)) for v in (f0, albedo))
    fresnel = f0_ + (1 - f0_) * (1 - cosine.clamp(0, 1)) ** 5
    return albedo_ / pi * irradiance + fresnel * gloss


def compose(probe: Tensor, seed: int, size: tuple[int, int] = (480, 720)) -> Composed:
    """A random scene with one to three balls."""
    rng = np.random.default_rng(seed)
    height, width = size
    fov = float(rng.uniform(15, 45))
    focal = width / 2 / tan(radians(fov) / 2)
    kind = str(rng.choice(["environment", "texture", "table"]))
    dark = bool(rng.random() < 0.2)
    around = Surroundings(probe, rng, kind, dark)
    fine_h, fine_w = height * SUPERSAMPLING, width * SUPERSAMPLING
    y, x = torch.meshgrid(torch.arange(fine_h) + 0.5, torch.arange(fine_w) + 0.5, indexing="ij")
    rays = normalize(
        torch.stack(
            [(x / SUPERSAMPLING - width / 2) / focal, (height / 2 - y / SUPERSAMPLING) / focal, -torch.ones_like(x)], -1
        ),
        dim=-1,
    )
    image = around(torch.zeros(3), rays)
    balls: list[tuple[Tensor, float, bool]] = []
    n = int(rng.choice([1, 1, 1, 2, 3]))
    cut = bool(rng.random() < 0.15)
    sharp = bool(rng.random() < 0.3)
    for i in range(n):
        mirror = bool(rng.random() < 0.3)
        for _ in range(50):
            r = float(np.exp(rng.uniform(np.log(0.10), np.log(0.42)))) * height
            if i:
                r = min(r, 0.75 * focal * tan(radians(balls[-1][1])))
            r = max(r, 20.0)
            margin = rng.uniform(-0.3, 0.0) * r if cut and not i else 1.06 * r
            px, py = (
                float(rng.uniform(margin, side - margin)) if side > 2 * margin else side / 2 for side in (width, height)
            )
            d = normalize(torch.tensor([(px - width / 2) / focal, (height / 2 - py) / focal, -1.0]), dim=0)
            alpha = asin(r / np.hypot(focal, np.hypot(px - width / 2, py - height / 2)))
            if cut and not i and _share_outside(d, alpha, focal, size) > 0.3:
                continue
            if all(torch.acos((d @ o).clamp(-1, 1)) > 1.15 * (alpha + radians(a)) for o, a, _ in balls):
                break
        else:
            continue
        balls.append((d, degrees(alpha), mirror))
        distance = 1 / sin(alpha)
        centre = d * distance
        pano_to = directions(_PANORAMA)
        panorama = around(centre, pano_to).permute(2, 0, 1).contiguous()
        panoramas = [blurred(panorama, b) for b in BLURS_DEG]
        along = rays @ centre
        inside = along**2 - distance**2 + 1 > 0
        if rng.random() < 0.5:
            _stand(image, rays, d, alpha, rng, inside)
        r_in = rays[inside]
        t = along[inside] - (along[inside] ** 2 - distance**2 + 1).clamp_min(0).sqrt()
        normals = normalize(t[:, None] * r_in - centre, dim=-1)
        image[inside] = shade(normals, -r_in, panoramas, rng, mirror)
    photo = avg_pool2d(image.permute(2, 0, 1)[None], SUPERSAMPLING)[0]
    import cv2

    sigma = float(rng.uniform(0.3, 0.6 if sharp else 1.3))
    photo = torch.from_numpy(cv2.GaussianBlur(photo.permute(1, 2, 0).numpy(), (0, 0), sigma)).permute(2, 0, 1)
    e = torch.from_numpy(rng.normal(size=(2, *photo.shape)).astype(np.float32))
    photo = (photo * (1 + 0.01 * e[0]) + 0.002 * photo.clamp_max(10).mean() * e[1]).clamp_min(0)
    return Composed(
        photo.contiguous(), fov, balls, f"{kind}{', dark' if dark else ''}{', cut' if cut else ''}, {len(balls)} balls"
    )


def _share_outside(d: Tensor, alpha: float, focal: float, size: tuple[int, int]) -> float:
    r = focal * tan(alpha) / float(-d[2])
    px, py = size[1] / 2 - focal * float(d[0] / d[2]), size[0] / 2 + focal * float(d[1] / d[2])
    y, x = np.mgrid[-1:1:99j, -1:1:99j]
    disc = x**2 + y**2 < 1
    x, y = px + r * x[disc], py + r * y[disc]
    return float(((x < 0) | (y < 0) | (x > size[1]) | (y > size[0])).mean())


def _stand(image: Tensor, rays: Tensor, d: Tensor, alpha: float, rng: np.random.Generator, inside: Tensor) -> None:
    """A rod from below the ball to the lower border, which hides or meets the lowest part of the rim."""
    x = rays[..., 0] / -rays[..., 2] + float(d[0] / d[2])
    y = rays[..., 1] / -rays[..., 2] + float(d[1] / d[2])
    r = tan(alpha)
    half = rng.uniform(0.06, 0.35) * r * (1 + rng.uniform(0, 0.4) * (-y / r - 1).clamp_min(0))
    rod = (x.abs() < half) & (y < -0.5 * r)
    colour = torch.from_numpy((rng.uniform(0.02, 0.8) * np.ones(3)).astype(np.float32)) * image.mean()
    tone = 0.4 + 0.6 * (1 - (x / half).square()).clamp_min(0).sqrt()
    image[rod] = (colour * tone[..., None])[rod]
    if rng.random() < 0.5:
        inside &= ~(rod & (y < -rng.uniform(0.85, 0.97) * r))
