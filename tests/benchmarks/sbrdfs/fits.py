"""Lafortune fits of texels: speed beside scipy, errors over the bound of the noise, units, shadows, odd texels.

A texel is a diffuse and three lobes of random shapes under all pairs of 81 directions, with noise of 2 % and of 0.002.
Errors are of the function, never of parameters: RMS of (fitted - true) / sigma over sqrt(p / N) with p = 21, N = 19683.
"""

import time

import numpy as np
from scipy.optimize import least_squares

from processing.sbrdf.lafortune import FitStatus, LafortuneFit, fit_lafortune, lafortune_values
from processing.sbrdf.shadows import darkness, fit_lit
from service.bench import Result
from tests.benchmarks.yardsticks.material_samples import bonn_directions
from tests.reference import lafortune as reference

SEED, PARAMETERS, BLOCK = 1, 21, 250
SCALES = (1e-6, 1e-3, 0.3, 1e3, 1e6)
START = np.array([(-1.0, -1.0, 1.0, 10.0), (-1.0, -1.0, 0.6, 30.0), (1.0, 1.0, 0.8, 3.0)])  # C, n: scipy's

DIRECTIONS = bonn_directions()
LIGHT, VIEW = np.repeat(DIRECTIONS, len(DIRECTIONS), axis=0), np.tile(DIRECTIONS, (len(DIRECTIONS), 1))


def run(*, quick: bool) -> Result:
    """All of them; quick with fewer texels and four of scipy's fits."""
    speed, speed_rows = against_scipy(4 if quick else 24, 128 if quick else 512)
    error, error_rows = function_error(250 if quick else 2000)
    shadow, shadow_rows = shadowed(24 if quick else 200)
    unit, unit_rows = scale_invariance(8 if quick else 48)
    odd, odd_rows = odd_texels()
    rows = [*speed_rows, *error_rows, *shadow_rows, *unit_rows, *odd_rows]
    return Result(speed | error | shadow | unit | odd, rows)


def texels(rng, count):
    """True values, noisy ones, and the deviation (t, s, 1) that the channels share."""
    true = reference.values(*reference.materials(rng, count), LIGHT, VIEW)
    sigma = 0.02 * true.mean(axis=2, keepdims=True) + 0.002
    return true, (true + sigma * rng.normal(size=true.shape)).astype(np.float32), sigma


def over_bound(found, true, sigma):
    """The function's error over its bound (t,)."""
    return np.sqrt((((found - true) / sigma) ** 2).mean(axis=(1, 2)) * true[0].size / PARAMETERS)


def against_scipy(peers: int, count: int) -> tuple[dict[str, float], list[dict[str, object]]]:
    """Seconds per texel, taking turns, scipy's of the median: some of its fits wander for a thousand evaluations.

    scipy is given a start, ours searches its own; ours from scipy's start is a row.
    """
    true, noisy, sigma = texels(np.random.default_rng((SEED, 1)), count)
    variance = sigma[..., 0] ** 2
    given = from_start(count)
    fit_lafortune(noisy[:4], LIGHT, VIEW, variance=variance[:4], start=given.chosen(slice(4)))
    fit_lafortune(noisy[:4], LIGHT, VIEW, variance=variance[:4])
    ours_s, given_s, peer_s, errors = [], [], [], []
    for texel in range(peers):
        begun_s = time.perf_counter()
        fit = fit_lafortune(noisy, LIGHT, VIEW, variance=variance)
        ours_s.append((time.perf_counter() - begun_s) / count)
        begun_s = time.perf_counter()
        found = by_scipy(noisy[texel], sigma[texel])
        peer_s.append(time.perf_counter() - begun_s)
        errors.append(over_bound(found[None], true[texel, None], sigma[texel, None])[0])
    begun_s = time.perf_counter()
    fit_lafortune(noisy, LIGHT, VIEW, variance=variance, start=given)
    given_s = (time.perf_counter() - begun_s) / count
    begun_s = time.perf_counter()
    fit_lafortune(noisy, LIGHT, VIEW, variance=variance, start=fit)
    again_s = (time.perf_counter() - begun_s) / count
    seconds, size = float(np.median(ours_s)), "6561 samples of three channels"
    own = over_bound(lafortune_values(fit, LIGHT, VIEW), true, sigma)
    rows: list[dict[str, object]] = [
        {"method": "Lafortune, ours", "seconds": seconds, "error": float(np.median(own)), "size": size, "bound": 1.0},
        {"method": "Lafortune, scipy 'lm' with its Jacobian", "seconds": float(np.median(peer_s)), "size": size,
         "error": float(np.median(errors)), "slowest_s": float(np.max(peer_s)),
         "worst": float(np.max(errors)), "bound": 1.0, "peer": True},
        {"speed": "ours from scipy's start, without search", "seconds": given_s, "size": size},
        {"speed": "ours from its own result", "seconds": again_s, "size": size},
    ]  # fmt: skip
    return {"lafortune_fits_per_s": 1 / seconds, "fit_speedup_vs_scipy": float(np.median(peer_s)) / seconds}, rows


def from_start(count: int) -> LafortuneFit:
    """The fixed start for so many texels."""
    axis = np.broadcast_to(START[:, :3], (count, 3, 3)).astype(np.float32)
    exponent = np.broadcast_to(START[:, 3], (count, 3)).astype(np.float32)
    nothing = np.zeros((count, 3), np.float32)
    return LafortuneFit(
        nothing, axis, exponent, axis * 0 + 1, np.zeros(count, np.int8), nothing[:, 0], np.zeros(count, np.int32)
    )


def by_scipy(values, sigma):
    """Its values (s, 3): unknowns are the diffuse, and per lobe C_y, C_z, log n and the albedo; C_x keeps its start."""
    root, product = 1 / sigma, LIGHT * VIEW
    factor = LIGHT[:, 2:] * root
    begin = np.concatenate([[0.1] * 3, *([y, z, np.log(n), 0.3, 0.3, 0.3] for _, y, z, n in START)])

    def lobes(p):
        for j, x in enumerate(START[:, 0]):
            y, z, log_n, *albedo = p[3 + 6 * j : 9 + 6 * j]
            base = np.maximum(product @ (x, y, z), 1e-9)
            yield base, np.exp(log_n), np.array(albedo), base ** np.exp(log_n)

    def model(p):
        return factor * (p[:3] + sum(g[:, None] * albedo for _, _, albedo, g in lobes(p)))

    def jacobian(p):
        out = np.zeros((len(values), 3, PARAMETERS))
        for c in range(3):
            out[:, c, c] = factor[:, 0]
        for j, (base, n, albedo, g) in enumerate(lobes(p)):
            at, weighted = 3 + 6 * j, factor * g[:, None] * albedo
            for k in range(2):
                out[:, :, at + k] = weighted * (n * product[:, 1 + k] / base)[:, None]
            out[:, :, at + 2] = weighted * (n * np.log(base))[:, None]
            for c in range(3):
                out[:, c, at + 3 + c] = factor[:, 0] * g
        return out.reshape(-1, PARAMETERS)

    with np.errstate(all="ignore"):
        found = least_squares(
            lambda p: (model(p) - values * root).ravel(), begin, jacobian, method="lm", ftol=1e-6, xtol=1e-6
        )
        return model(found.x) / root


def function_error(count: int) -> tuple[dict[str, float], list[dict[str, object]]]:
    """Distribution over texels; those above twice the bound are in a wrong minimum."""
    ratios, rng = [], np.random.default_rng((SEED, 2))
    for _ in range(0, count, BLOCK):
        true, noisy, sigma = texels(rng, BLOCK)
        fit = fit_lafortune(noisy, LIGHT, VIEW, variance=sigma[..., 0] ** 2)
        ratios.append(over_bound(lafortune_values(fit, LIGHT, VIEW), true, sigma))
    ratio = np.concatenate(ratios)
    median, p90, p99, worst = (float(one) for one in np.percentile(ratio, (50, 90, 99, 100)))
    figures = {"function_error_over_bound_median": median, "function_error_over_bound_p90": p90,
               "function_error_over_bound_above_2": float((ratio > 2).mean())}  # fmt: skip
    row = {"distribution": "function", "median": median, "p90": p90, "p99": p99, "worst": worst, "count": len(ratio)}
    return figures, [row]


def shadowed(count: int) -> tuple[dict[str, float], list[dict[str, object]]]:
    """Three tenths of the samples without light but with noise: shadow rounds against a fit that knows the mask."""
    rng = np.random.default_rng((SEED, 3))
    true, noisy, _ = texels(rng, count)
    dark = rng.random(noisy.shape[:2]) < 0.3
    values = np.where(dark[..., None], 0.002 * rng.normal(size=noisy.shape), noisy).astype(np.float32)
    plain = fit_lafortune(values, LIGHT, VIEW)
    found = fit_lit(values, LIGHT, VIEW, plain, darkness(values, LIGHT, VIEW, plain)).lobes
    known = fit_lafortune(np.where(dark[..., None], np.float32(np.nan), values), LIGHT, VIEW)
    error = {name: np.sqrt(((lafortune_values(fit, LIGHT, VIEW) - true) ** 2).mean(axis=(1, 2)))
             for name, fit in (("all samples", plain), ("shadow rounds", found), ("mask known", known))}  # fmt: skip
    ratio = error["shadow rounds"] / error["mask known"]
    rows: list[dict[str, object]] = [
        {"shadowed": name, "median": float(np.median(one)), "p90": float(np.quantile(one, 0.9)), "count": count}
        for name, one in (*error.items(), ("shadow rounds over mask known", ratio))
    ]
    return {"shadowed_over_masked_error": float(np.median(ratio))}, rows


def scale_invariance(count: int) -> tuple[dict[str, float], list[dict[str, object]]]:
    """Change of the function where the values are in another unit, RMS over RMS; the worst texel and scale.

    Powers of two change nothing at all. Other factors round the values, after which a search may end elsewhere.
    """
    _, noisy, _ = texels(np.random.default_rng((SEED, 4)), count)
    own = lafortune_values(fit_lafortune(noisy, LIGHT, VIEW), LIGHT, VIEW)
    size, changes = np.sqrt((own**2).mean(axis=(1, 2))), []
    for scale in SCALES:
        found = lafortune_values(fit_lafortune(noisy * np.float32(scale), LIGHT, VIEW), LIGHT, VIEW) / np.float32(scale)
        changes.append(np.sqrt(((found - own) ** 2).mean(axis=(1, 2))) / size)
    median, p99, worst = (float(one) for one in np.percentile(changes, (50, 99, 100)))
    row: dict[str, object] = {"distribution": "change by the unit", "median": median, "p99": p99, "worst": worst,
                              "above_1e-4": float((np.array(changes) > 1e-4).mean()), "count": count}  # fmt: skip
    return {"scale_invariance": worst}, [row]


def odd_texels() -> tuple[dict[str, float], list[dict[str, object]]]:
    """Cases that break other solvers; each counts that raises or leaves a number that is not finite."""
    rows: list[dict[str, object]] = []
    for name, (values, start) in reference.odd_texels(LIGHT, VIEW).items():
        try:
            fit = fit_lafortune(values, LIGHT, VIEW, start=from_start(len(values)) if start else None)
            numbers = (fit.diffuse, fit.axis, fit.exponent, fit.albedo, fit.cost, lafortune_values(fit, LIGHT, VIEW))
            broken = int((~np.isfinite(np.concatenate([one.ravel() for one in numbers]))).any())
            status = FitStatus(fit.status[0]).name
        except Exception as error:  # noqa: BLE001 - that it raises is what is counted
            broken, status = 1, repr(error)
        rows.append({"odd": name, "status": status, "broken": broken})
    return {"nan_or_exception": float(sum(int(str(row["broken"])) for row in rows))}, rows
