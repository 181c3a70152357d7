"""TensoRF of nerfstudio, trained on silhouettes along the rays in the water; run by tensorf_rays.sh.

python tensorf_rays.py RAYS MASKS OUTPUT [--central] [--iterations N]

RAYS is a folder of `rhizotwin export --rays`. With --central, the rays of each picture are replaced by those of the
best camera with a single centre of projection.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
import torch
import water_rays
from nerfstudio.cameras.rays import RayBundle
from nerfstudio.data.scene_box import SceneBox
from nerfstudio.field_components.encodings import TensorVMEncoding
from nerfstudio.model_components.ray_samplers import UniformSampler
from nerfstudio.model_components.renderers import AccumulationRenderer
from nerfstudio.model_components.scene_colliders import AABBBoxCollider

VOXEL_MM = 0.5
RESOLUTION, COMPONENTS, SAMPLES, BATCH = 128, 8, 64, 1024
LEARNING_RATES, SPARSITY = (0.02, 0.002), 5e-4  # as nerfstudio
SCALE_MM = 50.0  # unit of length of the field
DEVICE = "cuda" if torch.cuda.is_available() else "cpu"


class Field:
    """Density in a box, and the rays that cross the box."""

    def __init__(self, origin, direction, root, box_mm):
        self.box = tensor(box_mm / SCALE_MM)
        rays = RayBundle(tensor(origin / SCALE_MM), tensor(direction), torch.ones(len(origin), 1, device=DEVICE))
        self.rays = AABBBoxCollider(SceneBox(self.box))(rays)
        self.crossing = torch.nonzero(self.rays.fars[:, 0] > self.rays.nears[:, 0] + 1e-4)[:, 0]
        self.root = torch.tensor(root, device=DEVICE)
        self.sampler = UniformSampler(num_samples=SAMPLES, single_jitter=True)
        self.encoding = TensorVMEncoding(resolution=RESOLUTION, num_components=COMPONENTS).to(DEVICE)

    def density(self, positions):
        """Return the density at positions (R, S, 3)."""
        return torch.relu(self.encoding(2.0 * SceneBox.get_normalized_positions(positions, self.box) - 1.0).sum(-1, keepdim=True))

    def draw(self):
        """Return the samples of some rays, their densities, and whether the rays meet a root."""
        chosen = self.crossing[torch.randint(len(self.crossing), (BATCH,), device=DEVICE)]
        samples = self.sampler(self.rays[chosen])
        return samples, self.density(samples.frustums.get_positions()), self.root[chosen]

    def train(self, iterations):
        """Fit the opacities of the rays to the silhouettes."""
        optimiser = torch.optim.Adam(self.encoding.parameters(), lr=LEARNING_RATES[0])
        decay = torch.optim.lr_scheduler.ExponentialLR(optimiser, (LEARNING_RATES[1] / LEARNING_RATES[0]) ** (1.0 / iterations))
        for _ in range(iterations):
            samples, dense, is_root = self.draw()
            opacity = AccumulationRenderer.forward(samples.get_weights(dense))[:, 0]
            optimiser.zero_grad()
            sparsity = sum(part.abs().mean() for part in self.encoding.parameters())
            (torch.mean((opacity - is_root.float()) ** 2) + SPARSITY * sparsity).backward()
            optimiser.step()
            decay.step()

    def threshold(self):
        """Return the threshold of the density at which the silhouettes of the shape agree best with the masks."""
        drawn = [(dense.amax(dim=(1, 2)), is_root) for _, dense, is_root in (self.draw() for _ in range(20))]
        highest, is_root = (torch.cat(part) for part in zip(*drawn, strict=True))
        levels = torch.quantile(highest, torch.linspace(0.01, 0.99, 99, device=DEVICE))
        iou = torch.stack([((highest > level) & is_root).sum() / ((highest > level) | is_root).sum() for level in levels])
        sys.stdout.write(f"threshold {levels[iou.argmax()] / SCALE_MM:.3f}/mm, IoU of the silhouettes {iou.max():.3f}\n")
        return levels[iou.argmax()]

    def voxels(self, box_mm, radius_mm, threshold):
        """Return which voxels (X, Y, Z) in a cylinder exceed the threshold, layer by layer in x."""
        x_mm, y_mm, z_mm = (np.arange(low + VOXEL_MM / 2.0, high, VOXEL_MM) for low, high in box_mm.T)
        layers = []
        for x in x_mm:
            centres = np.stack(np.meshgrid([x], y_mm, z_mm, indexing="ij"), axis=-1)
            dense = self.density(tensor(centres.reshape(1, -1, 3) / SCALE_MM)).reshape(centres.shape[:3])
            layers.append((dense > threshold).cpu().numpy() & (np.hypot(centres[..., 0], centres[..., 1]) < radius_mm))
        return np.concatenate(layers)


def tensor(values):
    """Return values as a tensor of 32-bit numbers."""
    return torch.tensor(values, dtype=torch.float32, device=DEVICE)


parser = argparse.ArgumentParser()
parser.add_argument("rays")
parser.add_argument("masks")
parser.add_argument("output", type=Path)
parser.add_argument("--central", action="store_true")
parser.add_argument("--iterations", type=int, default=800)
options = parser.parse_args()
torch.manual_seed(0)
origin, direction, root = water_rays.read(options.rays, options.masks, options.central)
box_mm, radius_mm = water_rays.box_around(origin, direction, root)
field = Field(origin, direction, root, box_mm)
field.train(options.iterations)
with torch.no_grad():
    occupancy = field.voxels(box_mm, radius_mm, field.threshold())
options.output.mkdir(parents=True)
np.savez_compressed(options.output / "voxels.npz", occupancy=occupancy, origin_mm=box_mm[0], voxel_mm=VOXEL_MM)
