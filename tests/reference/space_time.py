"""Slow twin of processing.space_time: one pixel at a time, whole profiles in memory, plain linear algebra."""

import numpy as np

BLOCK, AROUND = 4, 3
OK, TOO_DARK, CUT_OFF, DOUBLE, SATURATED, DISTORTED = range(6)


def peak_time(profile_dn, sensor, width, tolerance, times=None):
    """Time, variance, amplitude and status of one pixel's profile (t,), for a given common width in frames."""
    count = len(profile_dn)
    times = np.arange(count, dtype=float) if times is None else np.asarray(times, float)
    if not profile_dn.any():
        return np.nan, np.nan, 0.0, TOO_DARK
    brightest = int(np.argmax(profile_dn))
    near = np.abs(np.arange(count) // BLOCK - brightest // BLOCK) <= AROUND
    y = (profile_dn - sensor.black_dn) * sensor.gain_e_per_dn
    if near.sum() < 4:
        return np.nan, np.nan, 0.0, CUT_OFF
    second = y[~near].max() if (~near).any() else -sensor.black_dn * sensor.gain_e_per_dn
    away = np.abs(np.arange(count) - brightest) > min(int(3.5 * width + 1), 12)
    others = away.sum()
    background = y[away].mean() if others >= 4 else y[near].min()
    t, y = times[near], y[near]
    theta = start(t, y, times[brightest], background, width, sensor)
    first_guess, height = theta[:2]
    noise = (max(background, 0.0) + sensor.dark_variance_e2) / max(others, 1)
    prior = np.diag([0, 0, 1 / (noise + ((0.02 if others >= 4 else 0.1) * theta[1]) ** 2), tolerance**-2.0])
    expected = np.array([0, 0, background, np.log(width)])
    centre = first_guess if (y >= sensor.saturation_e).any() else times[brightest]
    fitted = np.abs(t - centre) <= 3.5 * width + 1
    converged = score(t[fitted], y[fitted], theta, prior, expected, sensor)
    clipped = y[fitted] >= sensor.saturation_e
    mean, jacobian = pulse(t[fitted], theta)
    weight = np.where(clipped, 0.0, 1 / (np.maximum(mean, 0) + sensor.dark_variance_e2))
    covariance = solve((jacobian.T * weight) @ jacobian + prior, np.eye(4))
    if not converged or covariance is None or abs(theta[0] - first_guess) > 1 + 1.5 * width:
        converged = False
        theta = np.array([first_guess, height, background, np.log(width)])
        covariance = (max(background, 0.0) + height + sensor.dark_variance_e2) * np.eye(4)
    at_end = brightest in (0, count - 1)
    status = judge(t, y, theta, covariance, (converged, at_end, times, width, tolerance, second - background), sensor)
    return theta[0], covariance[0, 0], theta[1], status


def score(t, y, theta, prior, expected, sensor):
    """Fisher scoring of theta in place; whether it came to rest."""
    for _ in range(25):
        mean, jacobian = pulse(t, theta)
        variance = np.maximum(mean, 0) + sensor.dark_variance_e2
        weight = np.where((y >= sensor.saturation_e) & (y - mean <= 0), 0.0, 1 / variance)
        information = (jacobian.T * weight) @ jacobian + prior
        step = solve(information, jacobian.T @ (weight * (y - mean)) + prior @ (expected - theta))
        if step is None:
            return False
        w = np.exp(theta[3])
        theta[0] += np.clip(step[0], -w, w)
        theta[1] = min(max(theta[1] + step[1], 0.2 * theta[1]), 20 * sensor.saturation_e)
        theta[2] += step[2]
        theta[3] += np.clip(step[3], -0.5, 0.5)
        settled = abs(step[0]) * np.sqrt(information[0, 0]) < 1e-3
        if settled and abs(step[1]) < 1e-2 * theta[1] and abs(step[3]) < 1e-2:
            return True
    return False


def solve(matrix, right):
    """Solution, or None where the matrix is not positive, or only by rounding."""
    try:
        lower = np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        return None
    if np.any(np.diag(lower) ** 2 <= 1e-10 * np.diag(matrix)):
        return None
    return np.linalg.solve(lower.T, np.linalg.solve(lower, right))


def judge(t, y, theta, covariance, facts, sensor):
    converged, at_end, times, width, tolerance, second = facts
    w = np.exp(theta[3]) if converged else width  # not exp(log(width)): in whole frames both are at a limit
    mean, _ = pulse(t, theta)
    light = mean - theta[2]
    clipped = y >= sensor.saturation_e
    shows = ~clipped & (light > 3 * np.sqrt(light + max(theta[2], 0) + sensor.dark_variance_e2))
    flanked = not clipped.any() or ((shows & (t < theta[0])).any() and (shows & (t > theta[0])).any())
    excess = y - mean
    noise = np.sqrt(np.maximum(mean, 0) + sensor.dark_variance_e2)
    another = (~clipped & (excess > 0.4 * theta[1]) & (excess > 5 * noise)).any()
    if not theta[1] > 5 * np.sqrt(max(covariance[1, 1], sensor.dark_variance_e2 / len(t))):
        return TOO_DARK
    if at_end or min(theta[0] - times[0], times[-1] - theta[0]) < w:
        return CUT_OFF
    if not converged or abs(theta[3] - np.log(width)) > max(np.log(2), 3 * tolerance):
        return DISTORTED
    if not flanked:
        return SATURATED
    edge = np.exp(-0.5 * (12 / w) ** 2)
    return DOUBLE if another or second > (0.4 + edge) * theta[1] else OK


def start(t, y, peak, background, width, sensor):
    clipped = y >= sensor.saturation_e
    if clipped.any():
        return np.array([t[clipped].mean(), 1.2 * (sensor.saturation_e - background), background, np.log(width)])
    centres = t[np.abs(t - peak) <= 3]
    bells = np.exp(-0.5 * ((t - centres[:, None]) / width) ** 2)
    norm, product = (bells**2).sum(axis=1), bells @ (y - background)
    best = np.argmax(product / np.sqrt(norm))
    return np.array([centres[best], max(product[best] / norm[best], 1.0), background, np.log(width)])


def pulse(t, theta):
    """Mean (n,) and its derivatives (n, 4) by time, amplitude, background, log width."""
    u = (t - theta[0]) / np.exp(theta[3])
    bell = np.exp(-0.5 * u * u)
    rise = theta[1] * bell
    return rise + theta[2], np.stack([rise * u / np.exp(theta[3]), bell, np.ones_like(t), rise * u * u], axis=1)
