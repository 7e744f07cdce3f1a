"""Pictures in and out: every encoding, against other readers; damaged files end in one clear error."""

import struct
import zlib

import numpy as np
import OpenEXR
import pytest
import torch
from PIL import Image

from torchbrdf import read_image, save_image
from torchbrdf.io import exr, rgbe


def srgb_decoded(x):
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


@pytest.mark.parametrize("suffix", [".png", ".bmp"])
def test_8_bit_pictures_are_decoded_to_linear(tmp_path, suffix):
    codes = np.random.default_rng(0).integers(0, 256, (5, 7, 3), dtype=np.uint8)
    Image.fromarray(codes).save(tmp_path / f"a{suffix}")
    linear = read_image(tmp_path / f"a{suffix}")
    assert linear.shape == (5, 7, 3)
    assert linear.dtype == torch.float32
    assert linear.is_contiguous()
    np.testing.assert_allclose(linear.numpy(), srgb_decoded(codes / 255.0), atol=1e-6)  # float32 pow
    np.testing.assert_array_equal(read_image(tmp_path / f"a{suffix}", srgb=False).numpy(), codes.astype(np.float32) / np.float32(255))


def test_every_8_bit_code_survives_a_round_trip(tmp_path):
    codes = np.arange(256, dtype=np.uint8).reshape(16, 16, 1).repeat(3, -1)
    Image.fromarray(codes).save(tmp_path / "a.png")
    save_image(tmp_path / "b.png", read_image(tmp_path / "a.png"))
    assert np.array_equal(np.asarray(Image.open(tmp_path / "b.png")), codes)


def test_alpha_and_grey_are_kept_and_alpha_is_not_decoded(tmp_path):
    Image.fromarray(np.full((2, 3, 4), 128, np.uint8)).save(tmp_path / "rgba.png")
    Image.fromarray(np.full((2, 3), 128, np.uint8)).save(tmp_path / "grey.png")
    Image.fromarray(np.full((2, 3), 128, np.uint8)).convert("P").save(tmp_path / "palette.png")
    rgba, grey = read_image(tmp_path / "rgba.png"), read_image(tmp_path / "grey.png")
    assert rgba[0, 0].tolist() == pytest.approx([*[float(srgb_decoded(128 / 255))] * 3, 128 / 255], rel=1e-6)
    assert grey.shape == (2, 3, 1)
    assert grey[0, 0].item() == pytest.approx(float(srgb_decoded(128 / 255)), rel=1e-6)
    assert read_image(tmp_path / "palette.png").shape == (2, 3, 3)


@pytest.mark.parametrize(("colour_type", "channels"), [(0, 1), (2, 3), (6, 4)])
def test_16_bit_png_keeps_all_its_bits(tmp_path, colour_type, channels):
    codes = np.random.default_rng(1).integers(0, 1 << 16, (4, 6, channels), dtype=np.uint16)
    (tmp_path / "a.png").write_bytes(deep_png(codes, colour_type))
    np.testing.assert_array_equal(read_image(tmp_path / "a.png", srgb=False).numpy(), codes.astype(np.float32) / np.float32(65535))


def deep_png(codes, colour_type):
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    height, width, _ = codes.shape
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in codes)
    head = struct.pack(">IIBBBBB", width, height, 16, colour_type, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def test_photographs_are_turned_upright(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 6  # turn by 90 degrees clockwise
    Image.fromarray(np.zeros((4, 8, 3), np.uint8)).save(tmp_path / "a.jpg", exif=exif)
    assert read_image(tmp_path / "a.jpg").shape == (8, 4, 3)


def test_exposure_and_clipping_of_a_saved_picture(tmp_path):
    image = torch.tensor([[[0.0, 0.25, 4.0]]])
    save_image(tmp_path / "a.png", image, exposure=1.0)
    assert np.asarray(Image.open(tmp_path / "a.png")).tolist() == [[[0, 188, 255]]]  # sRGB of one half is 187.5


def test_saved_exr_is_linear_and_exact_for_planar_and_leaf_tensors(tmp_path):
    image = (torch.rand(3, 5, 7, dtype=torch.float64) * 10 - 5).requires_grad_().movedim(0, -1)
    save_image(tmp_path / "a.exr", image)
    assert torch.equal(read_image(tmp_path / "a.exr"), image.detach().float())
    save_image(tmp_path / "y.exr", image[..., :1])
    assert torch.equal(read_image(tmp_path / "y.exr"), image[..., :1].detach().float())


def test_non_finite_pixels_are_kept_by_exr_and_shown_with_a_warning(tmp_path):
    image = torch.tensor([[[np.nan, np.inf, -np.inf]]])
    save_image(tmp_path / "a.exr", image)
    assert torch.equal(read_image(tmp_path / "a.exr").isnan(), image.isnan())
    with pytest.warns(UserWarning, match="3 non-finite"):
        save_image(tmp_path / "a.png", image)
    assert np.asarray(Image.open(tmp_path / "a.png")).tolist() == [[[0, 255, 0]]]


def rand(*shape):
    return torch.rand(*shape, generator=torch.Generator().manual_seed(0))


REFUSED = {
    "format": ("a.gif", rand(2, 2, 3), r"a\.gif: the name must end in one of \.png, .*\.exr"),
    "empty": ("a.png", rand(0, 2, 3), r"found float32 \[0, 2, 3\]; it has no pixels"),
    "bytes": ("a.png", torch.zeros(2, 2, 3, dtype=torch.uint8), r"found uint8 \[2, 2, 3\]; divide by 255 and decode its sRGB"),
    "mask": ("a.png", rand(4, 5, 1) > 0.5, r"found bool \[4, 5, 1\]; convert it, for example with image\.float\(\)"),
    "complex": ("a.exr", torch.zeros(4, 5, 3, dtype=torch.complex64), "found complex64"),
    "one pixel": ("a.exr", rand(3), r"one pixel is image\.reshape\(1, 1, -1\)"),
    "list of pixels": ("a.png", rand(20, 3), r"list of pixels, did you mean image\.reshape\(H, W, 3\)"),
    "list of grey pixels": ("a.exr", rand(20, 1), r"did you mean image\.reshape\(H, W, 1\)"),
    "batch": ("a.png", rand(5, 4, 6, 3), r"found float32 \[5, 4, 6, 3\]; it is a batch: save one picture of it, such as image\[0\]$"),
    "lights and views": ("a.exr", rand(2, 5, 4, 6, 3), r"such as image\[0, 0\]$"),
    "channels first": ("a.png", rand(3, 4, 6), r"found float32 \[3, 4, 6\]; did you mean image\.movedim\(0, -1\)\?"),
    "grey, channel first": ("a.exr", rand(1, 4, 6), r"did you mean image\.movedim\(0, -1\)\?"),
    "alpha": ("a.png", rand(4, 5, 4), r"alpha is not written: did you mean image\[\.\.\., :3\]"),
    "many channels": ("a.exr", rand(4, 5, 7), r"choose three channels or one: did you mean image\[\.\.\., :3\]"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_saved_is_named_with_its_remedy(tmp_path, case):
    name, image, match = REFUSED[case]
    with pytest.raises(ValueError, match=match):
        save_image(tmp_path / name, image)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["a.png", "a.exr"])
@pytest.mark.parametrize("image", [rand(4, 6), rand(3, 6), rand(4, 2)])
def test_two_axes_are_a_grey_picture(tmp_path, name, image):
    save_image(tmp_path / name, image)
    save_image(tmp_path / f"again_{name}", image.unsqueeze(-1))
    assert (tmp_path / name).read_bytes() == (tmp_path / f"again_{name}").read_bytes()
    torch.testing.assert_close(read_image(tmp_path / name), image.unsqueeze(-1), atol=0.02, rtol=0)


def test_a_missing_folder_and_a_missing_file_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="nowhere"):
        save_image(tmp_path / "nowhere" / "a.png", torch.zeros(2, 2, 3))
    for read in (read_image, exr.read_exr):
        with pytest.raises(FileNotFoundError, match=r"gone\.exr"):
            read(tmp_path / "gone.exr")


# EXR


def write_parts(path, parts):
    with OpenEXR.File([OpenEXR.Part(dict(header), channels, name) for name, header, channels in parts]) as file:
        file.write(str(path))


def box(x0, y0, x1, y1):
    return (np.array([x0, y0], np.int32), np.array([x1, y1], np.int32))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.float16])
def test_strided_channels_are_written_right(tmp_path, dtype):
    wide = torch.rand(4, 5, 3, dtype=dtype)
    exr.write_exr(tmp_path / "a.exr", dict(zip(("normal.X", "normal.Y", "Z"), wide.unbind(-1), strict=True)))
    (channels,) = exr.read_exr(tmp_path / "a.exr").values()
    assert set(channels) == {"normal.X", "normal.Y", "Z"}
    for k, name in enumerate(("normal.X", "normal.Y", "Z")):
        assert np.array_equal(channels[name], wide[..., k].float().numpy())


@pytest.mark.parametrize("data", [(1, 2, 4, 4), (-2, -1, 9, 7), (6, 1, 12, 3), (20, 20, 22, 22)])
def test_pixels_land_in_the_display_window(tmp_path, data):
    """A data window inside, around, across and beside the display window of 8 x 6."""
    width, height = data[2] - data[0] + 1, data[3] - data[1] + 1
    pixels = np.arange(1, width * height + 1, dtype=np.float32).reshape(height, width)
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "dataWindow": box(*data),
        "displayWindow": box(0, 0, 7, 5),
    }
    with OpenEXR.File(header, {"Y": pixels}) as file:
        file.write(str(tmp_path / "a.exr"))
    expected = np.zeros((6, 8), np.float32)
    for (y, x), v in np.ndenumerate(pixels):
        if 0 <= y + data[1] < 6 and 0 <= x + data[0] < 8:
            expected[y + data[1], x + data[0]] = v
    assert np.array_equal(read_image(tmp_path / "a.exr")[..., 0].numpy(), expected)


def test_every_part_is_read_and_the_combined_picture_found(tmp_path):
    rng = np.random.default_rng(2)
    arrays = {k: rng.random((3, 4), dtype=np.float32) for k in "RGBXYZ"}
    plain = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    parts = [
        ("V.Normal", plain, {f"V.Normal.{k}": arrays[k] for k in "XYZ"}),
        ("V.Colour", plain, {f"V.Colour.{k}": arrays["X"] for k in "RGB"}),
    ]
    write_parts(tmp_path / "a.exr", [*parts, ("V.Combined", plain, {f"V.Combined.{k}": arrays[k] for k in "RGB"})])
    layers = exr.read_exr(tmp_path / "a.exr")
    assert list(layers) == ["V.Normal", "V.Colour", "V.Combined"]
    assert np.array_equal(layers["V.Normal"]["V.Normal.Z"], arrays["Z"])
    assert np.array_equal(read_image(tmp_path / "a.exr").numpy(), np.stack([arrays[k] for k in "RGB"], -1))
    write_parts(tmp_path / "b.exr", [*parts, ("V.Other", plain, {f"V.Other.{k}": arrays[k] for k in "RGB"})])
    with pytest.raises(ValueError, match=r"several pictures, \['V.Colour', 'V.Other'\]"):
        read_image(tmp_path / "b.exr")
    write_parts(tmp_path / "c.exr", parts[:1])
    with pytest.raises(ValueError, match="no R, G, B and no Y"):
        read_image(tmp_path / "c.exr")


def test_half_floats_become_float32(tmp_path):
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(
        header, {"R": np.full((2, 2), 0.1, np.float16), "G": np.zeros((2, 2), np.float16), "B": np.zeros((2, 2), np.float16)}
    ) as file:
        file.write(str(tmp_path / "a.exr"))
    assert read_image(tmp_path / "a.exr")[0, 0, 0].item() == np.float32(np.float16(0.1))


@pytest.mark.parametrize("channels", [{}, {"R": torch.zeros(2, 3), "G": torch.zeros(3, 2)}, {"R": torch.zeros(2, 3, 1)}])
def test_channels_that_make_no_picture_are_refused(tmp_path, channels):
    with pytest.raises(ValueError, match=r"channels \[H, W\] of one size"):
        exr.write_exr(tmp_path / "a.exr", channels)


def exr_bytes(tmp_path):
    write_parts(
        tmp_path / "whole.exr",
        [
            (n, {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, {"R": np.random.rand(64, 64).astype(np.float32)})
            for n in "ab"
        ],
    )
    return (tmp_path / "whole.exr").read_bytes()


def enlarged(data):
    at = data.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
    return data[:at] + struct.pack("<4i", 0, 0, 200_000, 200_000) + data[at + 16 :]


@pytest.mark.parametrize(
    ("why", "damage"),
    [
        ("Unable to open", lambda d: b""),
        ("Unable to open", lambda d: b"hello" * 100),
        ("Unable to open", lambda d: d[:100]),
        ("only 1 of its 2 parts", lambda d: d[:-2000]),
        ("of its 2 parts", lambda d: d[: len(d) // 2]),
        ("claims 200001 x 200001 pixels", enlarged),  # 160 GB
    ],
)
def test_a_damaged_exr_is_one_error_that_names_it(tmp_path, why, damage):
    (tmp_path / "bad.exr").write_bytes(damage(exr_bytes(tmp_path)))
    with pytest.raises(ValueError, match=rf"bad\.exr is damaged.*{why}"):
        read_image(tmp_path / "bad.exr")


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.xyz"])
@pytest.mark.parametrize("keep", [0, 40, 700])
def test_a_truncated_picture_is_one_error_that_names_it(tmp_path, name, keep):
    image = Image.fromarray(np.random.default_rng(3).integers(0, 256, (64, 64, 3), dtype=np.uint8))
    image.save(tmp_path / name, format="JPEG" if name == "a.jpg" else "PNG")
    data = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(data[:keep])
    with pytest.raises(ValueError, match=rf"{name} is damaged"):
        read_image(tmp_path / name)
    (tmp_path / "16.png").write_bytes(deep_png(np.zeros((64, 64, 3), np.uint16), 2)[:60])
    with pytest.raises(ValueError, match=r"16\.png is damaged"):
        read_image(tmp_path / "16.png")


# Radiance

HEADER = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n"


def quads(height, width, seed=0):
    """Pixels with runs and without, none of which is an old run mark."""
    rng = np.random.default_rng(seed)
    q = rng.integers(2, 256, (height, width, 4), dtype=np.uint8)
    q[:, 3 : width // 2] = q[:, 2:3]
    q[..., 3] = rng.integers(110, 140, (height, width))
    return q


def expected(q):
    return q[..., :3].astype(np.float64) * 2.0 ** (q[..., 3:].astype(np.float64) - 136)


def new_runs(q):
    out = bytearray()
    for row in q:
        out += bytes((2, 2, len(row) >> 8, len(row) & 255))
        for line in row.T:
            x = 0
            while x < len(line):
                n = 1
                while x + n < len(line) and n < 127 and line[x + n] == line[x]:
                    n += 1
                out += bytes((128 + n, line[x])) if n > 2 else bytes((n,)) + line[x : x + n].tobytes()
                x += n
    return bytes(out)


def old_runs(q):
    out = bytearray()
    for row in q:
        x = 0
        while x < len(row):
            n = 1
            while x + n < len(row) and (row[x + n] == row[x]).all():
                n += 1
            out += row[x].tobytes()
            if n > 1:  # in base 256, lowest digit first
                repeat = n - 1
                while repeat:
                    out += bytes((1, 1, 1, repeat & 255))
                    repeat >>= 8
            x += n
    return bytes(out)


@pytest.mark.parametrize("encode", [new_runs, old_runs, lambda q: q.tobytes()])
@pytest.mark.parametrize("width", [5, 8, 300, 700])
def test_every_radiance_encoding(encode, width):
    if encode is new_runs and width < 8:
        encode = old_runs
    q = quads(4, width)
    image = rgbe.decode(HEADER + b"-Y 4 +X %d\n" % width + encode(q))
    assert image.dtype == np.float32
    np.testing.assert_array_equal(image, expected(q).astype(np.float32))


@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize("mirror", [False, True])
@pytest.mark.parametrize("transposed", [False, True])
def test_every_radiance_orientation(flip, mirror, transposed):
    q = quads(4, 9)
    stored = q[::-1] if flip else q
    stored = stored[:, ::-1] if mirror else stored
    y, x = (b"+" if flip else b"-") + b"Y 4", (b"-" if mirror else b"+") + b"X 9"
    size = x + b" " + y if transposed else y + b" " + x
    data = HEADER + size + b"\n" + (stored.swapaxes(0, 1) if transposed else stored).tobytes()
    np.testing.assert_array_equal(rgbe.decode(data), expected(q).astype(np.float32))


def test_zero_exponent_is_black_and_exposure_is_divided_out(tmp_path):
    q = np.array([[[128, 64, 32, 129], [200, 200, 200, 0]]], np.uint8)
    (tmp_path / "a.hdr").write_bytes(b"#?RGBE\r\n# a comment\nEXPOSURE=2\nEXPOSURE= 4\n\n-Y 1 +X 2\n" + q.tobytes())
    assert read_image(tmp_path / "a.hdr").tolist() == [[[0.125, 0.0625, 0.03125], [0.0, 0.0, 0.0]]]
    decoded = read_image(tmp_path / "a.hdr", srgb=True)
    assert decoded[0, 0].tolist() == pytest.approx(srgb_decoded(np.array([0.125, 0.0625, 0.03125])), rel=1e-6)


GOOD = HEADER + b"-Y 4 +X 300\n" + new_runs(quads(4, 300))
AT = GOOD.index(b"\n", len(HEADER)) + 1  # the first scanline


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"", "begin"),
        (b"P6 3 3", "begin"),
        (b"#?RADIANCE\n" + b"x" * 100_000, "no end"),
        (HEADER, "no end"),
        (HEADER + b"-Y four +X 4\n", "size line"),
        (HEADER + b"-Y 4 +Y 4\n", "size line"),
        (HEADER + b"-Y 0 +X 4\n", "at least one"),
        (HEADER + b"-Y 99999999 +X 99999999\n", "cannot hold"),
        (HEADER.replace(b"rgbe", b"xyze") + b"-Y 1 +X 1\n1234", "FORMAT"),
        (b"#?RADIANCE\nEXPOSURE=0\n\n-Y 1 +X 1\n1234", "EXPOSURE"),
        (GOOD[:AT], "scanline 0 of 4"),
        (GOOD[:-1], "scanline 3 of 4"),
        (GOOD[: AT + 5], "scanline 0 of 4"),
        (GOOD[: AT + 4] + bytes((0,)) + GOOD[AT + 5 :], "incomplete"),
        (GOOD[: AT + 4] + bytes((255, 7)) * 3 + GOOD[AT + 4 :], "381 pixels in a row of 300"),
        (HEADER + b"-Y 1 +X 3\n" + b"\1\1\1\3" + b"abcd" * 3, "leaves its row"),
        (HEADER + b"-Y 1 +X 3\n" + b"abcd" + b"\1\1\1\3", "leaves its row"),
        (HEADER + b"-Y 1 +X 3\n" + b"abcd" * 2, "ends early"),
    ],
)
def test_a_damaged_radiance_picture_is_one_error_that_says_why(tmp_path, data, why):
    (tmp_path / "bad.hdr").write_bytes(data)
    with pytest.raises(ValueError, match=rf"bad\.hdr.*{why}"):
        read_image(tmp_path / "bad.hdr")


def test_no_prefix_of_a_radiance_picture_does_worse_than_an_error():
    """Cut anywhere, and with every byte of the first lines flipped: a picture of the right size or a ValueError."""
    for cut in range(0, len(GOOD), 7):
        with pytest.raises(ValueError, match=r"it does not begin|no end|size line|is cut short"):
            rgbe.decode(GOOD[:cut])
    for at in range(min(len(GOOD), 600)):
        flipped = GOOD[:at] + bytes((GOOD[at] ^ 0x55,)) + GOOD[at + 1 :]
        try:
            image = rgbe.decode(flipped)
        except ValueError:
            continue
        assert image.size <= 3 * 10**6


def test_a_real_radiance_picture_agrees_with_another_reader(real_data):
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    path = real_data / "hdri" / "studio.hdr"
    other = np.array(mi.Bitmap(str(path)).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32))
    np.testing.assert_array_equal(read_image(path).numpy(), other)
