"""The contribution of haloes to the spectra of matter, and the smooth remainder (Cooray & Sheth 2002, section 4).

With the haloes' profile u, their disc g and V = M mu / rho (halo_profile):

    h_t(k) = int_t dlnM n V b (u - g)                                   of each tier t of lensing haloes,
    P_1h(k) = int dlnM n V^2 <(u - g)^2>

Haloes follow the kernels s of the smooth field that are wide for their tier (w_ts = 1; 0 for narrow ones, and a
fraction for the two in between), with a weight f_s:

    C_l = sum_s a_s^2 B_s(l) (1 + f_s sum_t w_ts h_t)^2 + C_1h + C_ln,     f_s = 1 / (1 - sum_t w_ts h_t(l_s))

B_s is the spectrum of kernel s, l_s its peak. With these weights haloes follow all matter, smooth part and haloes:
their cross-spectrum with matter is b times the spectrum of matter. C_l is linear in a_s^2. The amplitudes are fitted
such that it is that of halofit, within 3 %: near l = 200 at z < 0.6 the other terms leave too little for the smooth
part. C_ln is due to haloes that cluster more than linearly with the field (intensity); the first term already includes
the part b b' xi of their correlation. In it b is the weighted mean of a tier. The cross-spectrum of haloes with the
smooth field is b times that of the field, but that with other haloes is larger (`around`).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from itertools import combinations_with_replacement
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline, RectBivariateSpline
from scipy.optimize import nnls
from scipy.special import j0

from csstsim.base.types import FloatArray, Floats, IntArray
from csstsim.universe.lensing.potential_field import pixel
from csstsim.universe.structure.density import kernel_weights
from csstsim.universe.structure.halo_profile import disc_radius, disc_transform, halo_transform, whole_mass
from csstsim.universe.structure.haloes import concentration, tier_orders
from csstsim.universe.structure.intensity import excess, series

if TYPE_CHECKING:
    from csstsim.universe.lensing.potential_field import PotentialField, Width
    from csstsim.universe.structure.mass_function import HaloMassFunction

_NODES, _GAUSS = np.polynomial.legendre.leggauss(4)  # of a shell's depth
_MASSES = 24  # nodes of a tier
_SCATTER, _CHANCES = np.polynomial.hermite_e.hermegauss(3)  # of log concentration
_LN_K = np.linspace(np.log(1e-4), np.log(300.0), 130)  # 1 / Mpc
_REDSHIFTS = 14
_ITERATIONS = 1000  # maximum of a fit: kernels overlap, and thick shells need more than 3 per kernel
_THETA = np.geomspace(1e-6, 1.0, 1200)  # rad
_ELL = np.geomspace(1, 1e5, 50)  # multipoles of C_ln
_FRACTION_MIN = 1e-5  # of matter, times bias, below which a tier has no C_ln: it has too few haloes for pairs


class _Moments(NamedTuple):
    """Integrals over the masses of one tier (k,): int dlnM n V b^p <u - g> for p = 1, 2, and P_1h."""

    linear: FloatArray
    squared: FloatArray
    one_halo: FloatArray


class _Clustering(NamedTuple):
    """Quantities of C_ln at multipoles _ELL and angles _THETA.

    second (shells, tiers, l): responses with b^2; bias (shells, tiers): mean of a tier; transform (l, theta): Hankel;
    correlation (widths, theta): of kappa, for amplitude 1.
    """

    second: FloatArray
    bias: FloatArray
    transform: FloatArray
    correlation: FloatArray


class HaloSpectra:
    """The haloes' part of the spectra. field: the PotentialField that they follow; others: as for haloes.Haloes."""

    def __init__(self, field: PotentialField, mass_function: HaloMassFunction, numbers: Mapping[str, Any]) -> None:
        haloes = numbers["haloes"]
        self.field = field
        self.limits = (haloes["z_min"], haloes["z_max"])
        tiers = np.array(haloes["tiers"])
        lensing = np.flatnonzero(tiers[:-1] >= 0.999 * haloes["lens_mass"])
        self.orders = tier_orders(field, mass_function, numbers)[lensing]
        z = np.linspace(*self.limits, _REDSHIFTS)
        moments = np.array([[_moments(mass_function, tiers[t], tiers[t + 1], at, haloes) for at in z] for t in lensing])
        tiers_of = _Moments(*np.moveaxis(moments, 2, 0))  # each (tiers, z, k)
        self._one = RectBivariateSpline(z, _LN_K, tiers_of.one_halo.sum(axis=0))
        self._linear = [RectBivariateSpline(z, _LN_K, h) for h in tiers_of.linear]
        self._squared = [RectBivariateSpline(z, _LN_K, h) for h in tiers_of.squared]
        self._nodes()
        self.weights = self._weights()

    def _nodes(self) -> None:
        shells = self.field.shells
        cosmology = self.field.shells.cosmology
        near = shells.edges[:-1, None]
        far = shells.edges[1:, None]
        low, high = cosmology.comoving_distance(np.array(self.limits))
        begin = np.clip(near, low, high)
        end = np.clip(far, low, high)
        self._chi = 0.5 * (begin + end) + 0.5 * (end - begin) * _NODES
        self._z = np.interp(self._chi, *shells.distances)
        strength = shells.strength(self._z)
        self._weight = 0.5 * (end - begin) * _GAUSS * strength**2  # of P in C_l of the shell
        self._fraction = 0.5 * (end - begin) * _GAUSS * strength * self._chi / shells.kernel()[:, None]  # of delta

    def one_halo(self, ell: FloatArray | IntArray) -> FloatArray:
        """Return C_1h (shells, len(ell)) for sources at infinity."""
        return np.einsum("in,inl->il", self._weight, self._at(self._one, ell))

    def response(self, ell: FloatArray | IntArray, squared: bool = False) -> FloatArray:
        """Return h_t (shells, tiers, len(ell)) with the bias or its square, as fractions of the shell's overdensity."""
        splines = self._squared if squared else self._linear
        return np.stack([np.einsum("in,inl->il", self._fraction, self._at(h, ell)) for h in splines], axis=1)

    def _at(self, spline: RectBivariateSpline, ell: FloatArray | IntArray) -> FloatArray:
        ln_k = np.log((np.asarray(ell) + 0.5) / self._chi[..., None])
        z = np.broadcast_to(self._z[..., None], ln_k.shape)
        return np.where(ln_k < _LN_K[-1], spline(z, np.maximum(ln_k, _LN_K[0]), grid=False), 0.0)

    def _weights(self) -> FloatArray:
        """Return f_s (shells, widths) from the response at the multipole at which each kernel has its maximum power."""
        peak = np.sqrt(2) / np.array([width.sigma for width in self.field.widths])
        response = np.einsum("tis,its->is", self.wide(), self.response(peak))
        return 1 / (1 - response)

    def wide(self) -> FloatArray:
        """Return w_ts (tiers, shells, widths)."""
        return np.stack([kernel_weights(self.field, orders) for orders in self.orders])

    def factors(self, ell: FloatArray | IntArray) -> FloatArray:
        """Return (1 + f_s sum_t w_ts h_t)^2 (shells, len(ell), widths)."""
        return (1 + self.weights[:, None] * np.einsum("tis,itl->ils", self.wide(), self.response(ell))) ** 2

    def fit(self, ell: FloatArray | IntArray, wanted: FloatArray) -> FloatArray:
        """Return the amplitudes a_is (shells, widths) with which C_l is `wanted` (shells, len(ell))."""
        bases = self.field.powers(ell) * self.factors(ell)
        rest = wanted - self.one_halo(ell)
        extra: Floats = 0.0
        for _ in range(4):  # C_ln depends on the amplitudes and changes them by 10 % at most: four steps converge
            fits = [
                nnls(b / w[:, None], r / w, maxiter=_ITERATIONS)[0]
                for b, w, r in zip(bases, wanted, rest - extra, strict=True)
            ]
            amplitude = np.sqrt(fits)
            extra = self.lognormal(ell, amplitude)
        return amplitude

    def lognormal(self, ell: FloatArray | IntArray, amplitude: FloatArray) -> FloatArray:
        """Return C_ln (shells, len(ell)) for amplitudes (shells, widths)."""
        kernel = self.field.shells.kernel()[:, None]
        clustering = self._clustering
        second = clustering.second
        bias = clustering.bias
        wide = self.wide()
        total = np.zeros((len(kernel), len(_ELL)))
        variance = np.einsum(
            "is,tis,s->it", (amplitude * self.weights / kernel) ** 2, wide**2, clustering.correlation[:, 0]
        )
        sigma = np.sqrt(variance)
        terms = series(bias * sigma)  # (n, shells, tiers)
        for t, u in combinations_with_replacement(range(len(wide)), 2):
            rows = np.flatnonzero(bias[:, t] * bias[:, u])
            power = ((amplitude * self.weights) ** 2 * wide[t] * wide[u])[rows]
            xi = np.einsum("is,st->it", power, clustering.correlation) / kernel[rows] ** 2  # of delta (shells, theta)
            r = xi / (sigma[rows, t] * sigma[rows, u])[:, None]
            curved = excess(terms[:, rows, t], terms[:, rows, u], r) / (bias[rows, t] * bias[rows, u])[:, None] ** 2
            hankel = np.einsum("it,lt->il", curved, clustering.transform)
            total[rows] += (1 if t == u else 2) * second[rows, t] * second[rows, u] * hankel
        return CubicSpline(np.log(_ELL), total * kernel**2, axis=1)(np.log(ell))

    def around(
        self, ell: FloatArray | IntArray, amplitude: FloatArray, shell: int, tier: int, bias: float
    ) -> FloatArray:
        """Return the spectrum (len(ell),) of haloes with the other matter of their shell, both as overdensities.

        tier: of the lensing ones, from 0; amplitude: as for `lognormal`. Its Hankel transform is the mean overdensity
        about haloes of that bias, without their own mass.
        """
        kernel = self.field.shells.kernel()[shell]
        clustering = self._clustering
        biases = clustering.bias[shell]
        wide = self.wide()[:, shell]
        strength = amplitude[shell] / kernel
        powers = self.field.powers(ell)
        response = 1 + self.weights[shell] * np.einsum("ts,tl->ls", wide, self.response(ell)[shell])
        linear = bias * (strength**2 * self.weights[shell] * wide[tier] * powers * response).sum(axis=1)
        power = (strength * self.weights[shell]) ** 2 * wide
        sigma = np.sqrt((power * wide) @ clustering.correlation[:, 0])
        series_of_tier = series(bias * sigma[tier])
        extra = np.zeros(len(_ELL))
        for t in np.flatnonzero(biases):
            r = (power[t] * wide[tier]) @ clustering.correlation / (sigma[t] * sigma[tier])
            curved = excess(series_of_tier, series(biases[t] * sigma[t]), r)
            extra += clustering.second[shell, t] / biases[t] ** 2 * (clustering.transform @ curved)
        return linear + CubicSpline(np.log(_ELL), extra)(np.log(ell))

    @cached_property
    def _clustering(self) -> _Clustering:
        first = self.response(_ELL)
        second = self.response(_ELL, squared=True)
        peak = np.argmax(np.abs(second), axis=2, keepdims=True)
        linear = np.take_along_axis(first, peak, axis=2)[..., 0]
        squared = np.take_along_axis(second, peak, axis=2)[..., 0]
        bias = np.divide(squared, linear, out=np.zeros_like(squared), where=np.abs(linear) > _FRACTION_MIN)
        transform = 2 * np.pi * np.gradient(np.log(_THETA)) * _THETA**2 * j0(np.outer(_ELL, _THETA))  # (l, theta)
        correlation = np.stack([_correlation(width) for width in self.field.widths])
        return _Clustering(second, bias, transform, correlation)


def _moments(
    mass_function: HaloMassFunction, low: float, high: float, z: float, numbers: Mapping[str, Any]
) -> _Moments:
    """Return the _Moments of one tier of haloes from mass `low` to `high` [solar] at redshift z."""
    nodes, weights = np.polynomial.legendre.leggauss(_MASSES)
    ln_mass = 0.5 * np.log(low * high) + 0.5 * np.log(high / low) * nodes
    mass = np.exp(ln_mass)
    k = np.exp(_LN_K)[:, None]
    median = concentration(mass, z, numbers["concentration"], mass_function.cosmology.h0 / 100)
    scattered = [median * 10 ** (numbers["concentration"]["scatter"] * at) for at in _SCATTER]
    radius = mass_function.virial_radius(mass)
    disc = disc_transform(k, disc_radius(mass_function, mass, numbers))
    cuts = numbers["cuts"]
    profiles = np.stack([whole_mass(c, cuts) * (halo_transform(k, radius, c, cuts) - disc) for c in scattered])
    chances = _CHANCES / _CHANCES.sum()
    mean = np.einsum("s,skm->km", chances, profiles)
    square = np.einsum("s,skm->km", chances, profiles**2)
    number = 0.5 * np.log(high / low) * weights * mass_function.dn_dlnm(mass, z)
    volume = mass / mass_function.density
    bias = mass_function.bias(mass, z)
    return _Moments(
        linear=np.einsum("km,m->k", mean, number * volume * bias),
        squared=np.einsum("km,m->k", mean, number * volume * bias**2),
        one_halo=np.einsum("km,m->k", square, number * volume**2),
    )


def _correlation(width: Width) -> FloatArray:
    """Return the correlation of kappa at _THETA of one width with amplitude 1, for a flat sky: kernels are narrow.

    The Hankel transform of l^5 exp(-l^2 sigma^2) is exp(-x) L_2(x) / sigma^6, with x = theta^2 / (4 sigma^2).
    """
    x = np.minimum(_THETA**2 / (4 * width.sigma**2), 700.0)
    return 0.5 * np.pi * np.exp(-x) * (1 - 2 * x + x * x / 2) / (width.sigma**2 * pixel(width.order) ** 2)
