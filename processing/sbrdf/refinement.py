"""Shifts and hidden points of every view, from the voted ones, the tile's height field and the light from above.

The paper (Chen et al., 2.3.2) takes the voted shifts as they are and looks for the likes of hidden points in the tile.
Here a height field that all views share predicts the shifts first; and the light that comes from where the top view
looks tells what is hidden: it reaches just what that view sees.
"""

from dataclasses import dataclass, replace

import numba
import numpy as np
from numpy.typing import NDArray

from processing.products.arrays import Float32
from processing.sbrdf.flow_votes import Occlusion
from processing.sbrdf.heights import (
    INDISTINCT,
    Reconstruction,
    asked_views,
    between,
    points,
    slope,
    visible,
    vote_heights,
)
from processing.sbrdf.like_points import best_matches
from processing.sbrdf.samples import Samples

Mask = NDArray[np.bool_]

# Cosine between the top view and a light that reaches what it sees: 12 deg, by which 4 mm of relief move by 0.9 mm.
_NEARLY_SAME = 0.978
_UNLIT = 0.07  # of what points seen from the top show under the light from above
_CLEARER = 0.9  # of a distance: below, a place close by is preferred
_AROUND = 1  # texels around a shift that are tried where it does not match


def refine(samples: Samples, reconstruction: Reconstruction, voted: Occlusion) -> Occlusion:
    """What each view sees, after the heights, the light from above and the search for likes have had their say.

    A distance is the mean over lights and channels of |BTF(x, L, V) - reconstruction(x', L, V)|, of what both have. Of
    predicted and voted shift the predicted one is taken unless the other is clearly nearer. Where a light stands within
    12 deg of the top view, hidden is what it does not reach; else the voted hidden points are, but for those whose like
    in the tile is nearer than the view's other points are to theirs on average (the paper's rule). Points that are not
    hidden and farther than that average move by up to a texel. Views lower than 81 deg keep what was voted.
    """
    heights = vote_heights(samples, reconstruction)
    light = overhead(samples)
    shift, hidden = voted.shift.copy(), voted.hidden.copy()
    for view in asked_views(samples):
        pictures = _Pictures.of(samples, reconstruction, view)
        direction = samples.view_directions[view]
        predicted = (visible(heights, direction)[..., None] * slope(direction)).astype(np.float32)
        moved = pictures.nearer(predicted, voted.shift[view])
        if light is None:
            moved, hidden[view] = _elevated(pictures, moved, hidden[view])
        else:
            hidden[view] = unlit(pictures.seen, pictures.drawn, light)
        shift[view] = _settled(pictures, moved, hidden[view])
    shift[hidden] = 0
    return replace(voted, shift=shift, hidden=hidden)


@dataclass(frozen=True, eq=False)
class _Pictures:
    """What a view sees, and what the reconstruction says that it would see of each point of the top view."""

    seen: Float32
    drawn: Float32

    @classmethod
    def of(cls, samples: Samples, reconstruction: Reconstruction, view: int) -> "_Pictures":
        return cls(points(samples.seen_from(view)), points(reconstruction.seen_from(view)))

    def nearer(self, shift: Float32, other: Float32) -> Float32:
        """Of two shifts (y, x, 2) the first, unless the second is clearly nearer."""
        first, second = (distances(self.seen, self.drawn, way) for way in (shift, other))
        better = (first > INDISTINCT) & (second < _CLEARER * first)
        return np.where(better[..., None], other, shift)

    def matched(self, shift: Float32, places: NDArray[np.intp], limit: np.float32) -> tuple[Float32, Mask]:
        """Shifts to the likes of the points at `places` (n, 2) where these are nearer than `limit`, and which are."""
        found, distance = best_matches(self.seen, self.drawn, places)
        better = distance < limit
        moved = shift.copy()
        moved[places[better, 0], places[better, 1]] = found[better]
        return moved, better


def _elevated(pictures: _Pictures, shift: Float32, hidden: Mask) -> tuple[Float32, Mask]:
    """The paper's rule: hidden points nearer to their like than the others are on average are not hidden."""
    usual = _usual(distances(pictures.seen, pictures.drawn, shift), hidden)
    places = np.argwhere(hidden)
    moved, better = pictures.matched(shift, places, usual)
    left = hidden.copy()
    left[places[better, 0], places[better, 1]] = False
    return moved, left


def _settled(pictures: _Pictures, shift: Float32, hidden: Mask) -> Float32:
    """Shifts (y, x, 2) of points that match worse than usual, at the nearest place close by.

    Not at their like anywhere in the tile: shifts are interpolated, and on the way from a place far away to those of
    the neighbours half the tile would be drawn within a texel.
    """
    apart = distances(pictures.seen, pictures.drawn, shift)
    usual = _usual(apart, hidden)
    return _close_by(pictures.seen, pictures.drawn, shift, apart, np.where(hidden, np.inf, usual))


def _usual(apart: Float32, hidden: Mask) -> np.float32:
    """Mean distance of the points that are not hidden, at least one that tells something."""
    others = apart[~hidden & np.isfinite(apart)]
    return np.float32(max(others.mean(dtype=np.float64), INDISTINCT) if len(others) else INDISTINCT)


def overhead(samples: Samples) -> int | None:
    """The light that shines from where the top view looks, within 12 deg and lit; None where there is none."""
    cosine = samples.light_directions @ samples.view_directions[samples.top]
    light = int(np.argmax(cosine))
    if cosine[light] < _NEARLY_SAME:
        return None
    return light if np.nansum(samples.seen_from(samples.top)[light]) > 0 else None


def unlit(seen: Float32, drawn: Float32, light: int) -> Mask:
    """Points (y, x) of `seen` that a light leaves dark, measured by what it does to those of `drawn`.

    Both are (y, x, light * 3). A point's value under the light counts over the root mean square of all its values;
    dark is below 0.07 of the median of `drawn`. So views in which the material itself is dark under that light, as a
    mirror is, tell of nothing; nor do points that no light brightens.
    """
    shares = _shares(drawn, light)
    known = shares[np.isfinite(shares)]
    dark: Mask = _shares(seen, light) < _UNLIT * (np.median(known) if len(known) else 0.0)
    return dark


def _shares(values: Float32, light: int) -> Float32:
    """Grey value (y, x) under a light over the root mean square under all that are known; NaN of what is black."""
    grey = values.reshape(*values.shape[:2], -1, 3).mean(axis=-1)
    known = np.isfinite(grey)
    squares = np.square(grey, where=known, out=np.zeros_like(grey)).sum(axis=-1) / np.maximum(known.sum(axis=-1), 1)
    return np.asarray(grey[..., light] / np.where(squares > 0, np.sqrt(squares), np.nan), np.float32)


@numba.njit(cache=True, parallel=True)
def distances(seen: Float32, drawn: Float32, shift: Float32) -> Float32:
    """Mean absolute difference (y, x) of `seen` to `drawn`, both (y, x, values), between its texels at x + shift.

    NaN where nothing can be compared; values of which one of the five is missing are left out.
    """
    height, width, _ = seen.shape
    out = np.empty((height, width), np.float32)
    for y in numba.prange(height):
        for x in range(width):
            out[y, x] = between(seen[y, x], drawn, x + shift[y, x, 0], y + shift[y, x, 1])
    return out


@numba.njit(cache=True, parallel=True)
def _close_by(seen: Float32, drawn: Float32, shift: Float32, apart: Float32, limit: Float32) -> Float32:
    """Shifts, of points farther `apart` than `limit`, both (y, x), the nearest of those a texel around."""
    height, width, _ = seen.shape
    moved = shift.copy()
    for y in numba.prange(height):
        for x in range(width):
            if not apart[y, x] > limit[y, x]:
                continue
            least = np.float32(_CLEARER) * apart[y, x]
            for down in range(-_AROUND, _AROUND + 1):
                for right in range(-_AROUND, _AROUND + 1):
                    to_right, to_below = shift[y, x, 0] + right, shift[y, x, 1] + down
                    distance = between(seen[y, x], drawn, x + to_right, y + to_below)
                    if distance < least:
                        least = distance
                        moved[y, x, 0], moved[y, x, 1] = to_right, to_below
    return moved
