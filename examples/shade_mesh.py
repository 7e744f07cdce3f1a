"""Shade a mesh: a picture, its plan, and a gradient.

    python examples/shade_mesh.py --mesh spot.obj --texture spot_texture.png --out out/spot.png

Without --mesh, a lumpy ring is made. The mesh casts shadows on itself.
"""

import argparse
from pathlib import Path

import torch
from recovery.builtin import lumpy_ring, true_albedo

import torchbrdf as tb


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mesh", type=Path, help="anything trimesh reads")
    parser.add_argument("--texture", type=Path, help="an image for the albedo (PNG and JPG are sRGB)")
    parser.add_argument("--eye", type=float, nargs=3, default=[-1.6, 0.9, -2.9])
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--out", type=Path, default=Path("out/shade_mesh.png"))
    args = parser.parse_args(argv)

    mesh = tb.load_mesh(args.mesh) if args.mesh else lumpy_ring()
    low, high = mesh.vertices.amin(0), mesh.vertices.amax(0)
    centre, radius = 0.5 * (low + high), 0.5 * float((high - low).norm())
    direction = tb.normalize(torch.tensor(args.eye))
    camera = tb.Camera.look_at(centre + 2.4 * radius * direction, centre, [0.0, 1.0, 0.0], fov_y=38.0, size=(args.size, args.size))
    g = tb.GBuffer.from_mesh(mesh, camera)

    texels = tb.read_image(args.texture)[..., :3] if args.texture else true_albedo(torch.Generator().manual_seed(1)).float()
    albedo = tb.nn.Texture(texels)(g).detach().requires_grad_()
    brdf = tb.Lambert(albedo) + tb.Phong(0.9, 60.0, fresnel=tb.Dielectric(1.5))
    right, up = camera.right.float(), torch.tensor([0.0, 1.0, 0.0])
    key = centre + 4.0 * radius * tb.normalize(direction - 0.6 * right + 0.7 * up)
    rim = centre + 4.0 * radius * tb.normalize(1.2 * right + 0.4 * up - 0.2 * direction)
    lights = tb.PointLight(torch.stack([key, rim]), torch.tensor([[44.0, 42.0, 38.0], [16.0, 20.0, 28.0]]) * radius**2)
    fill = tb.DirectionalLight(camera.origin - centre, 0.35)

    print(tb.plan(g, brdf, [lights, fill], mesh))
    image = tb.shade(g, brdf, [lights, fill], mesh=mesh)
    image.mean().backward()
    print(f"d mean radiance / d albedo: {float(albedo.grad.sum()):.4f} in all, over {int(g.valid.sum())} pixels")
    args.out.parent.mkdir(parents=True, exist_ok=True)
    tb.save_image(args.out, image.detach())
    print(f"wrote {args.out}")


if __name__ == "__main__":
    main()
