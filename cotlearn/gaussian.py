"""The exactly solvable case: conditional optimal transport between Gaussians, without a network.

Let c ~ N(0, S_c), x1 | c ~ N(A c + b, S) and x0 ~ N(0, I). The conditional coupling with weight
g between (x0, g c0) and (x1, g c1) is then the linear (Bures) map between two Gaussians. So
(x0, x1, c) is jointly Gaussian, the velocity is affine, and every error has a closed form. Batches
are infinite here: g -> infinity is optimal transport within each condition, not the independent
coupling. All arrays are float64 numpy.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg
from scipy.integrate import solve_ivp

from cotlearn import validation

Array = NDArray[np.float64]

LEAST = 1e-6  #: deviation of x1 down to which the differential equation is solved
LARGEST_WEIGHT = 1e12  #: g^2 c^2 up to which every error has six correct digits


@dataclass(frozen=True)
class LinearGaussian:
    """c ~ N(0, S_c), x1 | c ~ N(A c + b, S).

    Args:
        A: (d, k).
        b: (d,).
        S: (d, d), symmetric and positive definite.
        S_c: (k, k), symmetric and positive definite.
    """

    A: Array
    b: Array
    S: Array
    S_c: Array

    def __post_init__(self) -> None:
        A = validation.check_array(self.A, "A", (None, None))
        d, k = A.shape
        object.__setattr__(self, "A", A)
        object.__setattr__(self, "b", validation.check_array(self.b, "b", (d,)))
        object.__setattr__(self, "S", _positive_definite(self.S, "S", d))
        object.__setattr__(self, "S_c", _positive_definite(self.S_c, "S_c", k))

    @classmethod
    def example(cls) -> LinearGaussian:
        """The example of the course: d = 2, k = 1, A = (1.5, 0.5)', b = 0, S_c = 1."""
        A, S = np.array([[1.5], [0.5]]), np.array([[0.5, 0.2], [0.2, 0.3]])
        return cls(A, b=np.zeros(2), S=S, S_c=np.eye(1))

    @property
    def covariance(self) -> Array:
        """Covariance of (x1, c), shape (d + k, d + k)."""
        cross = self.A @ self.S_c
        return np.block([[cross @ self.A.T + self.S, cross], [cross.T, self.S_c]])

    def sample(self, n: int, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw n pairs (x1, c) of shapes (n, d) and (n, k)."""
        validation.check_has(rng, "rng", "a numpy.random.Generator", "multivariate_normal")
        validation.check_count(n, "n")
        c = rng.multivariate_normal(np.zeros(len(self.S_c)), self.S_c, size=n)
        noise = rng.multivariate_normal(np.zeros(len(self.S)), self.S, size=n)
        return c @ self.A.T + self.b + noise, c

    def flow(self, g: float | str, *, label: str = "target") -> AffineFlow:
        """The flow that an infinitely large network learns from a coupling.

        Args:
            g: COT Policy's g (2505.01179), condition_weight = g^2. 0 is naive optimal transport,
                math.inf optimal transport within each condition; or "independent". Finite values
                may be at most 1e6 (for S_c = 1).
            label: "target" gives the network the condition of x1, "source" that of x0.

        Raises:
            ValueError: g is negative, too large or an unknown name, or label is unknown.
        """
        validation.check_choice(label, "label", ("target", "source"))
        d = len(self.b)
        x0_x1, x0_c1, x1_c0 = self._plan(g)
        x1_x1, x1_c1 = self.covariance[:d, :d], self.covariance[:d, d:]
        if label == "target":
            x0_c, x1_c = x0_c1, x1_c1
        else:  # x0 is drawn with c0, and independent of it
            x0_c, x1_c = np.zeros_like(x0_c1), x1_c0
        blocks = [[np.eye(d), x0_x1, x0_c], [x0_x1.T, x1_x1, x1_c], [x0_c.T, x1_c.T, self.S_c]]
        return AffineFlow(self, np.block(blocks))

    def _plan(self, g: float | str) -> tuple[Array, Array, Array]:
        """Cov(x0, x1), Cov(x0, c1) and Cov(x1, c0) of a coupling."""
        d, k = self.A.shape
        x1_x1, x1_c1 = self.covariance[:d, :d], self.covariance[:d, d:]
        none = np.zeros((d, k))
        if isinstance(g, str):
            validation.check_choice(g, "g", ("independent",))
            return np.zeros((d, d)), none, x1_c1
        g = validation.check_number(g, "g", infinite=True)
        if math.isinf(g):  # x1 = A c + b + S^(1/2) x0, and c0 = c1
            return _sqrtm(self.S), none, x1_c1
        if g == 0:  # the map from N(0, I) ignores c, so x0 depends on c1 through x1 alone
            x0_x1 = _sqrtm(x1_x1)
            return x0_x1, x0_x1 @ np.linalg.solve(x1_x1, x1_c1), none
        if g**2 * np.linalg.eigvalsh(self.S_c).max() > LARGEST_WEIGHT:
            raise ValueError(f"g = {g:.3g} is too large for float64; use math.inf")
        scale = linalg.block_diag(np.eye(d), g * np.eye(k))
        source = linalg.block_diag(np.eye(d), g**2 * self.S_c)
        target = scale @ self.covariance @ scale
        cross = source @ bures_map(source, target)  # Cov((x0, g c0), (x1, g c1))
        return cross[:d, :d], cross[:d, d:] / g, cross[d:, :d].T / g


@dataclass(frozen=True)
class AffineFlow:
    """The flow of a joint Gaussian (x0, x1, c): v(t, x, c) = F(t) x + G(t) c + f(t).

    Attributes:
        problem: the law of (x1, c), the target of the flow.
        joint: covariance of (x0, x1, c), shape (2d + k, 2d + k).
    """

    problem: LinearGaussian
    joint: Array

    def skew(self) -> float:
        """E_c W2^2(p(x0 | c), N(0, I)): the distance of training noise from test-time noise."""
        d = len(self.problem.b)
        x0_c = self.joint[:d, 2 * d :]
        slope = np.linalg.solve(self.problem.S_c, x0_c.T).T
        covariance = np.eye(d) - slope @ x0_c.T
        return float(np.trace(slope @ x0_c.T) + bures_squared(covariance, np.eye(d)))

    def one_step_variance(self) -> float:
        """E tr Var(x1 | x0, c): the variance that a one-step model averages out."""
        d = len(self.problem.b)
        seen = np.r_[0:d, 2 * d : len(self.joint)]
        gain = _slope(self.joint[d : 2 * d, seen], self.joint[np.ix_(seen, seen)], 1e-15)
        left = self.joint[d : 2 * d, d : 2 * d] - gain @ self.joint[seen, d : 2 * d]
        return max(float(np.trace(left)), 0.0)

    def coefficients(self, t: float) -> tuple[Array, Array, Array]:
        """F (d, d), G (d, k) and f (d,) of v(t, x, c) = F x + G c + f, by Gaussian conditioning."""
        d = len(self.problem.b)
        x0, x1, c = np.split(np.eye(len(self.joint)), [d, 2 * d])
        velocity, seen = x1 - x0, np.vstack([(1 - t) * x0 + t * x1, c])
        cross = velocity @ self.joint @ seen.T
        gain = _slope(cross, seen @ self.joint @ seen.T, 1e-12)
        F, G = gain[:, :d], gain[:, d:]
        return F, G, self.problem.b - t * F @ self.problem.b

    def velocity(self, t: float, x: ArrayLike, c: ArrayLike) -> Array:
        """v(t, x, c) for x of shape (n, d) and c of shape (n, k); t in [0, 1]."""
        F, G, f = self.coefficients(validation.check_share(t, "t"))
        x = validation.check_array(x, "x", (None, len(F)))
        return x @ F.T + validation.check_array(c, "c", (len(x), G.shape[1])) @ G.T + f

    def law_after(self, c: ArrayLike, nfe: int | None = None) -> tuple[Array, Array]:
        """Mean (d,) and covariance (d, d) of the sample for one condition c of shape (k,).

        Args:
            c: the condition.
            nfe: Euler steps from N(0, I); None solves the ordinary differential equation.
        """
        P, q, C = self._after(nfe)
        return P @ validation.check_array(c, "c", (len(self.problem.S_c),)) + q, C

    def squared_w2(self, nfe: int | None = None) -> float:
        """E_c W2^2(law of the sample given c, p(x1 | c)), exactly.

        Args:
            nfe: Euler steps; None solves the ordinary differential equation.
        """
        P, q, C = self._after(nfe)
        slope = P - self.problem.A
        off = q - self.problem.b
        mean_error = np.trace(slope @ self.problem.S_c @ slope.T) + off @ off
        return float(mean_error + bures_squared(C, self.problem.S))

    def _after(self, nfe: int | None) -> tuple[Array, Array, Array]:
        """P, q and C: the sample given c is N(P c + q, C)."""
        d, k = self.problem.A.shape
        if nfe is None:
            M = self._exact
        else:
            M = np.eye(d, d + k + 1)
            for step in range(validation.check_count(nfe, "nfe")):
                M = M + self._derivative(step / nfe, M) / nfe
        U, P, q = np.split(M, [d, d + k], axis=1)
        return P, q[:, 0], U @ U.T

    @cached_property
    def _exact(self) -> Array:
        d, k = self.problem.A.shape

        def derivative(t: float, flat: Array) -> Array:
            return self._derivative(t, flat.reshape(d, -1)).ravel()

        start = np.eye(d, d + k + 1).ravel()
        of_x1 = np.sqrt(np.diag(self.problem.covariance)[:d])
        of_c = np.sqrt(np.diag(self.problem.S_c))
        if of_x1.min() < LEAST:
            raise ValueError(
                f"x1 must have deviations of at least {LEAST:g}, of the noise's 1, to solve the "
                f"equation in float64, got {of_x1.min():.3g}: give nfe, or scale x1"
            )
        units = np.outer(of_x1.clip(max=1), np.concatenate([np.ones(d), 1 / of_c, [1.0]]))
        options = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-12 * units.ravel()}
        end = solve_ivp(derivative, (0, 1), start, **options)
        return np.reshape(end.y[:, -1], (d, -1))

    def _derivative(self, t: float, M: Array) -> Array:
        """dM/dt for x_t = M (x0, c, 1): the state is affine in its initial noise and in c."""
        F, G, f = self.coefficients(t)
        return F @ M + np.column_stack([np.zeros_like(F), G, f])


def _slope(cross: Array, covariance: Array, rounding: float) -> Array:
    """cross @ covariance^-1, of variables in units of their own deviations.

    Else the units would decide which directions are taken for rounding errors and left out.
    """
    unit = 1 / np.sqrt(np.diag(covariance))
    scaled = covariance * np.outer(unit, unit)
    return (cross * unit) @ np.linalg.pinv(scaled, rcond=rounding, hermitian=True) * unit


def bures_map(source: Array, target: Array) -> Array:
    """The symmetric M with M source M = target: the optimal map N(0, source) -> N(0, target).

    Both matrices (d, d) must be positive definite. With R^2 = source and L L^T = target, the root
    of R target R is computed from the singular values of R L, because forming R target R would lose
    twice as many digits.
    """
    source = _positive_definite(source, "source")
    target = _positive_definite(target, "target", len(source))
    root = _sqrtm(source)
    inverse = np.linalg.inv(root)
    U, values, _ = np.linalg.svd(root @ np.linalg.cholesky(target))
    return inverse @ (U * values) @ U.T @ inverse


def bures_squared(first: Array, second: Array) -> float:
    """Squared W2 between N(0, first) and N(0, second), both (d, d), positive semi-definite."""
    first = _covariance(first, "first")
    second = _covariance(second, "second", len(first))
    root = _sqrtm(first)
    mixed = _sqrtm(root @ second @ root)
    return max(float(np.trace(first) + np.trace(second) - 2 * np.trace(mixed)), 0.0)


def _sqrtm(matrix: Array) -> Array:
    """Root of a symmetric positive semi-definite matrix; negative rounding errors become 0."""
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    return (vectors * np.sqrt(values.clip(min=0))) @ vectors.T


def _symmetric(value: ArrayLike, name: str, size: int | None = None) -> Array:
    array = validation.check_array(value, name, (size, size))
    largest = np.abs(array).max(initial=0)
    if array.shape[0] != array.shape[1] or np.abs(array - array.T).max() > 1e-8 * largest:
        raise ValueError(f"{name} must be symmetric, got {array.tolist()}")
    return array


def _covariance(value: ArrayLike, name: str, size: int | None = None) -> Array:
    array = _symmetric(value, name, size)
    values = np.linalg.eigvalsh(array)
    if values.min() < -1e-8 * np.abs(values).max():
        raise ValueError(f"{name} must be positive semi-definite, got {array.tolist()}")
    return array


def _positive_definite(value: ArrayLike, name: str, size: int | None = None) -> Array:
    array = _symmetric(value, name, size)
    if np.linalg.eigvalsh(array).min() <= 0:
        raise ValueError(f"{name} must be positive definite, got {array.tolist()}")
    return array
