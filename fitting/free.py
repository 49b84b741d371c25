"""What a fit may vary, ready made: ``fit(scene, measurement, [free.angle(), free.gain()])``.

Every prior is (mean, standard deviation) for a normal one, one of ``fitting.priors``, or None.
"""

import math
from collections.abc import Callable
from typing import Any

from fitting.parameters import Parameter, SpectralParameter
from fitting.priors import Number, as_prior
from fitting.spectra import Cauchy as Cauchy
from fitting.spectra import DrudeLorentz as DrudeLorentz
from fitting.spectra import Form, Smooth
from fitting.spectra import Sellmeier as Sellmeier

Where = Callable[[Any], Any]


def angle(
    lower_deg: Number = 5.0, upper_deg: Number = 180.0, prior: Any = None, *, name: str = "angle"
) -> Parameter:
    """The dihedral angle of ``VGrooves``.

    Args:
        lower_deg: smallest allowed angle, degrees, > 0. Below 5 degrees the search becomes slow.
        upper_deg: largest allowed angle, degrees, at most 180 (flat).
        prior: in degrees; None for none.
        name: under which the result lists it.

    Raises:
        ValueError: the bounds are not in order or outside 0 to 180 degrees.
    """
    if not 0 < lower_deg < upper_deg <= 180:
        raise ValueError(
            f"dihedral angles from {lower_deg:g} to {upper_deg:g} degrees; expected 0 < lower < upper ≤ 180"
        )
    known = as_prior(prior, name)
    radians = None if known is None else known.scaled(math.pi / 180)
    return Parameter(name, _angle, math.radians(lower_deg), math.radians(upper_deg), prior=radians, unit="rad")


def roughness(lower: Number = 0.01, upper: Number = 3.0, prior: Any = None) -> Parameter:
    """The roughness m of ``BeckmannGrooves`` or ``GaussianGrooves``, on a logarithmic scale.

    Args:
        lower: smallest allowed m, without unit, > 0.
        upper: largest allowed m.
        prior: of m; None for none.

    Raises:
        ValueError: the bounds are not in order or not positive.
    """
    return Parameter("roughness", lambda s: s.surface.roughness, lower, upper, prior=prior, scale="log")


def reflectance(
    *,
    smooth_nm: Number | None = None,
    lower: Number = 0.0,
    upper: Number = 1.0,
    prior: Number | None = None,
    where: Where | None = None,
    name: str = "reflectance",
) -> SpectralParameter:
    """The reflectance of the flat material, or the intrinsic one under an interface, at every wavelength.

    Args:
        smooth_nm: correlation length, nm, of a smooth spectrum, see ``spectra.Smooth``; None for a free value at
            each wavelength.
        lower: smallest allowed value.
        upper: largest allowed value.
        prior: standard deviation around the scene's own spectrum, as a share of it; None for none.
        where: picks it out of the scene; the material's reflectance unless given, for panels that differ.
        name: under which the result lists it.

    Raises:
        ValueError: the bounds are not in order within 0 to 1, or a length is not positive.
    """
    return _fraction(name, where or (lambda s: s.material.reflectance), smooth_nm, lower, upper, prior)


def transmittance(
    *,
    smooth_nm: Number | None = None,
    lower: Number = 0.001,
    upper: Number = 1.0,
    prior: Number | None = None,
    where: Where | None = None,
    name: str = "transmittance",
) -> SpectralParameter:
    """The transmittance of the layer under an interface, at every wavelength; see ``reflectance``."""
    return _fraction(name, where or (lambda s: s.material.layer.transmittance), smooth_nm, lower, upper, prior)


def coverage(lower: Number = 0.0, upper: Number = 1.0, prior: Any = None) -> Parameter:
    """The share of the area that a halftone covers."""
    return Parameter("coverage", lambda s: s.material.layer.coverage, lower, upper, prior=prior)


def index(lower: Number = 1.2, upper: Number = 2.5, prior: Any = None, *, where: Where | None = None) -> Parameter:
    """One real refractive index for all wavelengths, searched.

    Args:
        lower: smallest allowed index.
        upper: largest allowed index.
        prior: of the index; None for none.
        where: picks it out of the scene; the material's index unless given.

    Raises:
        ValueError: the bounds are not in order.
    """
    return Parameter("index", where or _index, lower, upper, prior=prior)


def index_spectrum(
    form: Form | None = None,
    *,
    complex_valued: bool = False,
    lower: tuple[Number, ...] | None = None,
    upper: tuple[Number, ...] | None = None,
    prior: Number | None = None,
    where: Where | None = None,
) -> SpectralParameter:
    """The refractive index as a spectrum: by a dispersion formula, or free at each wavelength.

    Free n and k at each wavelength have several solutions: the fit tries several starts and says so. Give a
    prior around a table where there is one.

    Args:
        form: ``free.Cauchy``, ``free.Sellmeier`` or ``free.DrudeLorentz``; None for free values.
        complex_valued: n and k, without a form.
        lower: smallest allowed n, or n and k; (1,) or (0.02, 0) unless given.
        upper: largest allowed n, or n and k; (4,) or (8, 12) unless given.
        prior: standard deviation around the scene's own index, as a share of its modulus; None for none.
        where: picks it out of the scene; the material's index unless given.

    Raises:
        ValueError: the bounds are not in order, or a form and a prior are both given.
    """
    names: tuple[str, ...] = ("n", "k") if complex_valued else ("n",)
    if form is not None:
        names = form.quantities
    low = lower or ((0.02, 0.0) if len(names) == 2 else (1.0,))
    high = upper or ((8.0, 12.0) if len(names) == 2 else (4.0,))
    return SpectralParameter("index", where or _index, names, low, high, form, prior)


def gain(prior: Any = (1.0, 0.01)) -> Parameter:
    """The gain of the instrument: predicted = gain × model + offset.

    Args:
        prior: 1 ± 0.01 unless said otherwise, None for an unknown gain.

    Raises:
        ValueError: the prior's standard deviation is not positive.
    """
    return Parameter("gain", None, -math.inf, math.inf, prior=prior, role="gain", start=_center(prior, 1.0))


def offset(prior: Any = (0.0, 0.002)) -> Parameter:
    """The offset of the instrument, as a reflectance factor: predicted = gain × model + offset.

    Args:
        prior: 0 ± 0.002 unless said otherwise, None for an unknown offset.

    Raises:
        ValueError: the prior's standard deviation is not positive.
    """
    return Parameter("offset", None, -math.inf, math.inf, prior=prior, role="offset", start=_center(prior, 0.0))


def tilt(prior_deg: Any = (0.0, 1.0), limit_deg: Number = 5.0) -> tuple[Parameter, Parameter]:
    """The tilt of the sample, as two angles: ``tilt_across`` and ``tilt_along`` the grooves.

    A positive tilt across adds to the polar angle of a view at azimuth 0, one along to that at 90 degrees.
    The light that comes from a direction is tilted too, with its irradiance; diffuse light is not changed. If all
    directions lie across the grooves, the sign of the tilt along them makes no difference: the positive one is
    reported.

    Args:
        prior_deg: of each, degrees; 0 ± 1 unless said otherwise, None for none.
        limit_deg: largest allowed tilt, degrees.

    Raises:
        ValueError: the limit is not between 0 and 30 degrees.
    """
    if not 0 < limit_deg <= 30:
        raise ValueError(f"tilt up to {limit_deg:g} degrees; expected a limit above 0, up to 30 degrees")
    known = as_prior(prior_deg, "tilt")
    prior = None if known is None else known.scaled(math.pi / 180)
    limit = math.radians(limit_deg)
    # Not at zero, where by symmetry nothing may depend on the tilt to first order.
    begin = math.radians(min(0.2, limit_deg / 10))
    across = Parameter("tilt_across", None, -limit, limit, prior, "rad", role="tilt_across", start=begin)
    return across, Parameter("tilt_along", None, -limit, limit, prior, "rad", role="tilt_along", start=begin)


def stray_light(upper: Number = 0.3, prior: Any = None) -> Parameter:
    """The share s of light of other wavelengths: measured = (1 - s) × true + s × mean of the measured spectrum.

    The mean is over the wavelengths measured in the same direction.

    Args:
        upper: largest allowed share.
        prior: of the share; None for none.

    Raises:
        ValueError: the upper bound is not between 0 and 1.
    """
    if not 0 < upper < 1:
        raise ValueError(f"a stray-light fraction up to {upper!r}; expected above 0, below 1")
    return Parameter("stray_light", None, 0.0, upper, prior, role="stray_light", start=_center(prior, 0.0))


def wavelength_shift(limit_nm: Number = 3.0, prior_nm: Any = (0.0, 1.0)) -> Parameter:
    """The error of the wavelength scale: what is recorded at λ was measured at λ + shift.

    Predicted spectra are interpolated (a cubic through neighbors, smooth in the shift); wavelengths nearer than
    the limit to either end have no neighbor and are left out of the fit.

    Args:
        limit_nm: largest allowed shift, nm.
        prior_nm: of the shift, nm; 0 ± 1 unless said otherwise, None for none.

    Raises:
        ValueError: the limit is not positive.
    """
    if not 0 < limit_nm < math.inf:
        raise ValueError(f"a wavelength shift up to {limit_nm!r} nm; expected a positive limit")
    return Parameter(
        "wavelength_shift", None, -limit_nm, limit_nm, prior_nm, "nm", role="wavelength_shift", start=0.0
    )


def parameter(
    name: str,
    where: Where,
    lower: Number,
    upper: Number,
    prior: Any = None,
    *,
    start: Number | None = None,
    unit: str = "1",
) -> Parameter:
    """Any other single real number in the scene.

    Args:
        name: under which the result lists it.
        where: picks the number, as in ``lambda scene: scene.material.reflectance``.
        lower: smallest allowed value, in the scene's own unit (radians for angles).
        upper: largest allowed value.
        prior: of the value; None for none.
        start: where the polish starts; None to search the whole range (for at most three parameters).
        unit: "rad" for an angle that is to be shown in degrees.

    Raises:
        ValueError: the bounds are not in order or not finite.
    """
    return Parameter(name, where, lower, upper, prior=prior, start=start, unit=unit)


def spectrum(
    name: str,
    where: Where,
    *,
    lower: Number = 0.0,
    upper: Number = 1.0,
    prior: Number | None = None,
    form: Form | None = None,
) -> SpectralParameter:
    """Any other real spectrum in the scene, with a free value at each wavelength or a form.

    Args:
        name: under which the result lists it.
        where: picks the spectrum, as in ``lambda scene: scene.material.first.reflectance``.
        lower: smallest allowed value.
        upper: largest allowed value.
        prior: standard deviation around the scene's own spectrum, as a share of it; None for none.
        form: say ``spectra.Smooth(name, 50)``.

    Raises:
        ValueError: the bounds are not in order.
    """
    return SpectralParameter(name, where, (name,), (lower,), (upper,), form, prior)


def _fraction(
    name: str, where: Where, smooth_nm: Number | None, lower: Number, upper: Number, prior: Number | None
) -> SpectralParameter:
    if not 0 <= lower < upper <= 1:
        raise ValueError(f"{name} from {lower!r} to {upper!r}; expected 0 ≤ lower < upper ≤ 1")
    form = None if smooth_nm is None else Smooth(name, smooth_nm)
    return SpectralParameter(name, where, (name,), (lower,), (upper,), form, prior)


def _center(prior: Any, otherwise: float) -> float:
    """Where a nuisance starts: at the middle of its prior."""
    known = as_prior(prior, "prior")
    gaussian = None if known is None else known.gaussian
    if gaussian is None:
        return otherwise
    return math.exp(gaussian[0]) if gaussian[2] else gaussian[0]


def _angle(scene: Any) -> Any:
    return scene.surface.angle


def _index(scene: Any) -> Any:
    return scene.material.index
