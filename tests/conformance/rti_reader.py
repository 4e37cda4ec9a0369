"""Readers of .ptm, .rti and web folders that know nothing of ours: from the published texts, byte by byte.

.ptm: Malzbender and Gelb, "Polynomial Texture Map (.ptm) File Format", HP Laboratories, 2001, sections 2.1 to 2.5.
.rti: the header and the terms that Cultural Heritage Imaging's documents give for HSH; row 0 is the top.
info.json: coefficient = (byte / 255 - bias) * scale, as Relight's and OpenLIME's documents say.
All answer with codes 0 to 255 of the pixel at a column from the left and a row from the top, under a light (x, y, z).
"""

import io
import json
import math
import struct

from PIL import Image


def ptm_pixel(path, column, row, light):
    file = io.BytesIO(path.read_bytes())
    assert file.readline() == b"PTM_1.2\n"
    kind = file.readline().strip().decode()
    width, height = int(file.readline()), int(file.readline())
    scale = [float(word) for word in file.readline().split()]
    bias = [int(word) for word in file.readline().split()]
    assert len(scale) == len(bias) == 6
    data = file.read()
    lu, lv, _ = light
    polynomial = [lu * lu, lv * lv, lu * lv, lu, lv, 1]
    texel = (height - 1 - row) * width + column

    def value(start):
        return sum((data[start + i] - bias[i]) * scale[i] * polynomial[i] for i in range(6))

    if kind == "PTM_FORMAT_RGB":
        assert len(data) == 18 * width * height
        return [value(6 * (channel * width * height + texel)) for channel in range(3)]
    assert kind == "PTM_FORMAT_LRGB"
    assert len(data) == 9 * width * height
    luminance = value(6 * texel)
    colours = 6 * width * height + 3 * texel
    return [luminance * data[colours + channel] / 255 for channel in range(3)]


def hsh_weights(light):
    x, y, z = light
    theta, phi = math.acos(z), math.atan2(y, x)
    c = math.cos(theta)
    q = math.sqrt(max(c - c * c, 0.0))
    pi = math.pi
    return [
        1 / math.sqrt(2 * pi),
        math.sqrt(6 / pi) * math.cos(phi) * q,
        math.sqrt(3 / (2 * pi)) * (2 * c - 1),
        math.sqrt(6 / pi) * math.sin(phi) * q,
        math.sqrt(30 / pi) * math.cos(2 * phi) * (c * c - c),
        math.sqrt(30 / pi) * math.cos(phi) * (2 * c - 1) * q,
        math.sqrt(5 / (2 * pi)) * (1 - 6 * c + 6 * c * c),
        math.sqrt(30 / pi) * math.sin(phi) * (2 * c - 1) * q,
        math.sqrt(30 / pi) * math.sin(2 * phi) * (c * c - c),
    ]


def rti_pixel(path, column, row, light):
    file = io.BytesIO(path.read_bytes())
    assert file.readline().startswith(b"#HSH1.2")
    assert int(file.readline()) == 3
    width, _, channels = (int(word) for word in file.readline().split())
    terms, _, size = (int(word) for word in file.readline().split())
    assert (channels, terms, size) == (3, 9, 1)
    scale = struct.unpack("<9f", file.read(36))
    offset = struct.unpack("<9f", file.read(36))
    file.seek((row * width + column) * 27, io.SEEK_CUR)
    data = file.read(27)
    weights = hsh_weights(light)
    return [
        255 * sum(w * (data[9 * channel + i] / 255 * scale[i] + offset[i]) for i, w in enumerate(weights))
        for channel in range(3)
    ]


def web_pixel(folder, column, row, light):
    info = json.loads((folder / "info.json").read_text())
    material = info["materials"][0]
    planes = []
    for number in range(info["nplanes"] // 3):
        with Image.open(folder / f"plane_{number}.{info['format']}") as picture:
            assert picture.size == (info["width"], info["height"])
            planes += picture.convert("RGB").getpixel((column, row))
    values = [(p / 255 - b) * s for p, b, s in zip(planes, material["bias"], material["scale"], strict=True)]
    x, y, _ = light
    weights = [1, x, y, x * x, x * y, y * y] if info["type"] == "ptm" else hsh_weights(light)
    assert info["colorspace"] == "rgb"
    return [255 * sum(w * v for w, v in zip(weights, values[channel::3], strict=True)) for channel in range(3)]
