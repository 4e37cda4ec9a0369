"""Sums over the views of a light that tell the shadow of least squared error."""

import numba


@numba.njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "nsz"})
def light_sums(values, weight, drawn, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Into `out` (t, light, 3): sums of weight times value^2, value times drawn and drawn^2.

    `values` and `drawn` are (t, light, view, 3), `weight` (t, light, view); values of no weight are not looked at.
    """
    texels, lights, views, channels = values.shape
    for t in range(texels):
        for light in range(lights):
            energy, cross, square = 0.0, 0.0, 0.0
            for view in range(views):
                w = weight[t, light, view]
                if w > 0:
                    for c in range(channels):
                        value, model = values[t, light, view, c], drawn[t, light, view, c]
                        energy += w * value * value
                        cross += w * value * model
                        square += w * model * model
            out[t, light, 0], out[t, light, 1], out[t, light, 2] = energy, cross, square
