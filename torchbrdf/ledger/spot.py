"""The angles of a real G-buffer: pixels of the cow Spot (Keenan Crane, CC0 1.0) seen by a camera under four point lights.

``python -m torchbrdf.ledger.spot tests/data/spot`` makes ``spot.json`` again, from the mesh and the ``scene.json`` there.
"""

import functools
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

FILE = Path(__file__).with_name("spot.json")
COUNT, DIGITS = 500, 6
SOURCE = "Spot, Keenan Crane's 3D Model Repository, CC0 1.0: lit pixels drawn evenly from the view and the four lights of tests/data/spot"


@functools.cache
def cosines() -> np.ndarray:
    """``[500, 3]``: n.wi, n.wo and wi.wo of a pixel each."""
    return np.array(json.loads(FILE.read_text(encoding="utf-8"))["pixels"])


def directions(rng: Any) -> dict[str, np.ndarray]:
    """The pixels' ``wi``, ``wo`` and ``n`` ``[500, 3]``, of which only the angles are known, each pixel turned anyhow."""
    cos_i, cos_o, between = cosines().T
    sin_i, sin_o = (np.sqrt(1.0 - c * c) for c in (cos_i, cos_o))
    both = sin_i * sin_o
    turn = np.clip((between - cos_i * cos_o) / np.where(both > 0, both, 1.0), -1.0, 1.0)  # the cosine of the angle about the normal
    wo = np.stack([sin_o, 0.0 * sin_o, cos_o], 1)
    wi = np.stack([sin_i * turn, sin_i * np.sqrt(1.0 - turn * turn), cos_i], 1)
    turned = np.linalg.qr(rng.normal(size=(len(wi), 3, 3)))[0]
    return {"wi": _along(turned, wi), "wo": _along(turned, wo), "n": turned[:, :, 2].copy()}


def angles() -> dict[str, np.ndarray]:
    """The cosines ``[500]`` that a Fresnel term is taken at: n.wo by a mirror, wi.h by a lobe."""
    return {"n.wo": cosines()[:, 1], "wi.h": np.sqrt(0.5 * (1.0 + cosines()[:, 2]))}


def _along(axes: np.ndarray, w: np.ndarray) -> np.ndarray:
    return np.einsum("nij,nj->ni", axes, w)


def make(folder: Path) -> None:
    """Trace the view of the scenes in ``folder`` and keep some of the pixels that a light reaches from the front."""
    lit = np.concatenate([_lit(scene) for scene in sorted(folder.glob("*/scene.json"))])
    chosen = np.random.default_rng(0).choice(len(lit), COUNT, replace=False)
    FILE.write_text(json.dumps({"source": SOURCE, "pixels": lit[chosen].round(DIGITS).tolist()}) + "\n", encoding="utf-8")


def _lit(scene_file: Path) -> np.ndarray:
    import torch

    import torchbrdf as tb

    scene = json.loads(scene_file.read_text(encoding="utf-8"))
    camera = tb.Camera.look_at(scene["eye"], scene["target"], scene["up"], scene["fov_y_deg"], (scene["res"],) * 2)
    g, found = tb.GBuffer.from_mesh(tb.load_mesh(scene_file.parent / scene["mesh"]), camera), []
    for light in scene["lights"]:
        wi, wo = tb.normalize(torch.tensor(light, dtype=g.position.dtype) - g.position), g.require_view()
        cosines = torch.stack([(a * b).sum(-1) for a, b in ((g.normal, wi), (g.normal, wo), (wi, wo))], -1)
        found.append(cosines[g.valid.squeeze(-1) & (cosines[..., 0] > 0.01) & (cosines[..., 1] > 0.01)].double().numpy())
    return np.concatenate(found)


if __name__ == "__main__":
    make(Path(sys.argv[1]))
