"""A standard regression of x1 on c: a ridge on smooth features, and a small network beside it."""

import warnings
from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

from cotlearn.couplings.base import Array
from cotlearn.couplings.units import Mask, TamedStandardiser

FEATURES = 150  #: radial functions of c, at most half of the rows
WIDTHS = 0.1, 1.0  #: of the radial functions: gamma times the number of columns
PENALTIES = np.logspace(-3, 4, 8)  #: of the ridge
FEWEST = 100  #: rows for a network
LAYERS, PENALTY, BATCH = (64, 64), 1.0, 64  #: of the network

Predictor: TypeAlias = Callable[[Array], Array]  #: conditions (m, k) -> x1 (m, d)


def regression(x1: Array, c: Array, *, seed: int = 0) -> Predictor:
    """Fit E[x1 | c] by a ridge regression and a small network, which share the prediction.

    The ridge learns from few rows, the network what changes along a few directions of many columns.
    The network is fitted to three quarters of the rows; on the last quarter the weight of the two
    is that of least squares, from 0 to 1. Of fewer than 100 rows the ridge predicts alone.

    Args:
        x1: (n, d), n at least 4.
        c: (n, k).
        seed: of the quarters, the ridge's features and the network.

    Returns:
        A function of conditions (m, k) that predicts x1, (m, d).
    """
    smooth = ridge(x1, c, seed=seed)
    if len(x1) < FEWEST:
        return smooth
    last = np.random.default_rng(seed).permutation(len(x1)) % 4 == 3
    deep = network(x1[~last], c[~last], seed=seed)
    plain = ridge(x1[~last], c[~last], seed=seed)(c[last])
    change = deep(c[last]) - plain
    size = float(np.square(change).sum())
    weight = float(np.clip(((x1[last] - plain) * change).sum() / size, 0, 1)) if size else 0.0
    return lambda new: (1 - weight) * smooth(new) + weight * deep(new)


def ridge(x1: Array, c: Array, *, seed: int = 0) -> Predictor:
    """Ridge regression on c and on radial functions of c.

    The radial functions stand on rows of c (Nystroem's approximation of a Gaussian kernel; Williams
    & Seeger 2001). Their width and the penalty are those with the least leave-one-out error.

    Args:
        x1: (n, d).
        c: (n, k).
        seed: of the rows on which the functions stand.
    """
    from sklearn.kernel_approximation import Nystroem  # late: they take a second
    from sklearn.linear_model import RidgeCV

    c, varies = _varying(c)
    scaler = TamedStandardiser.fit(c)
    places = scaler(c)
    size = min(FEATURES, len(c) // 2)
    fitted: list[tuple[float, Any, Any]] = []
    for width in WIDTHS:
        radial = Nystroem(gamma=width / c.shape[1], n_components=size, random_state=seed % 2**32)
        features = np.hstack([places, radial.fit_transform(places)])
        model = RidgeCV(PENALTIES).fit(features, x1)
        fitted.append((model.best_score_, radial, model))
    _, radial, model = max(fitted, key=lambda one: one[0])

    def predict(new: Array) -> Array:
        places = scaler(new[:, varies])
        features = np.hstack([places, radial.transform(places)])
        return model.predict(features).reshape(len(new), -1)

    return predict


def network(x1: Array, c: Array, *, seed: int = 0) -> Predictor:
    """A network of two hidden layers that stops when a tenth of the rows is predicted no better.

    Args:
        x1: (n, d).
        c: (n, k).
        seed: of its weights, batches and the tenth.
    """
    from sklearn.exceptions import ConvergenceWarning  # late: they take a second
    from sklearn.neural_network import MLPRegressor

    c, varies = _varying(c)
    scaler, middle = TamedStandardiser.fit(c), x1.mean(axis=0)
    size = float(np.sqrt(x1.var(axis=0).mean())) or 1.0
    options: dict[str, Any] = {"hidden_layer_sizes": LAYERS, "alpha": PENALTY, "batch_size": BATCH}
    options |= {"early_stopping": True, "learning_rate_init": 3e-3, "random_state": seed % 2**32}
    model = MLPRegressor(**options)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # 200 epochs are enough
        model.fit(scaler(c), ((x1 - middle) / size).squeeze())
    return lambda new: middle + size * model.predict(scaler(new[:, varies])).reshape(len(new), -1)


def _varying(c: Array) -> tuple[Array, Mask]:
    """The columns that vary, and which they are: of others alone the first, so that one is left."""
    varies = np.ptp(c, axis=0) > 0
    varies[0] |= not varies.any()
    return c[:, varies], varies
