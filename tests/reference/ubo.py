"""Writes a BTF as the University of Bonn published them: a picture for each pair of directions, in a folder or zip."""

import io
from zipfile import ZipFile

import numpy as np
from PIL import Image


def angles(directions):
    """Polar angle and azimuth in whole degrees."""
    polar = np.degrees(np.arccos(np.clip(directions[:, 2], -1, 1)))
    azimuth = np.degrees(np.arctan2(directions[:, 1], directions[:, 0])) % 360
    return [(round(p), round(a) % 360 if p > 0.5 else 0) for p, a in zip(polar, azimuth, strict=True)]


def vectors(polar_and_azimuth_deg):
    """Unit vectors of whole degrees."""
    polar, azimuth = np.radians(np.array(polar_and_azimuth_deg, float)).T
    return np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=1)


def codes(values, *, srgb=True):
    """Bytes of linear values in 0 to 1."""
    values = np.clip(values, 0, 1)
    if srgb:
        values = np.where(values <= 0.0031308, values * 12.92, 1.055 * values ** (1 / 2.4) - 0.055)
    return np.round(values * 255).astype(np.uint8)


def pictures(btf, *, srgb=True, ending="png", style="{i:05d} tl{tl:03d} pl{pl:03d} tv{tv:03d} pv{pv:03d}"):
    """Names and contents; views have folders of their own."""
    cosine = btf.light_directions[:, 2]
    views = angles(btf.view_directions)
    for n, (tl, pl) in enumerate(angles(btf.light_directions)):
        for m, (tv, pv) in enumerate(views):
            picture = io.BytesIO()
            values = codes(np.pi * cosine[n] * btf.reflectance[n, m].astype(np.float64), srgb=srgb)
            options = {"quality": 95, "subsampling": 0} if ending == "jpg" else {}
            Image.fromarray(values).save(picture, {"jpg": "jpeg"}.get(ending, ending), **options)
            name = style.format(i=n * len(views) + m, tl=tl, pl=pl, tv=tv, pv=pv)
            yield f"UBO_TEST/tv{tv:03d}_pv{pv:03d}/{name}.{ending}", picture.getvalue()


def write_zip(path, files):
    with ZipFile(path, "w") as archive:
        for name, content in files:
            archive.writestr(name, content)
    return path


def write_folder(path, files):
    for name, content in files:
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        (path / name).write_bytes(content)
    return path
