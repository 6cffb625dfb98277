"""Geodetic coordinates as places in metres north and east of an origin."""

import numpy as np

from estimators.checks import finite_array

_SEMI_MAJOR_AXIS = 6378137.0  # m, of the ellipsoid WGS84
_ECCENTRICITY_SQUARED = 0.00669437999014


def local(places: object, origin: object) -> np.ndarray:
    """Places ``(k, 2)`` north and east of an origin [m], from latitudes and longitudes on WGS84.

    They lie in the plane that touches the ellipsoid at the origin (Fossen 2021, ch. 2). A place
    that is 10 km away on the ellipsoid comes out 4 mm too near, one at 50 km half a metre, one at
    100 km 4.2 m: ``d^3 / (6 R^2)`` at a distance d, with the Earth's radius R. Across the bearing
    the error is below 2 cm.

    Args:
        places: Rows ``(k, 2)`` of latitude north and longitude east [deg].
        origin: Latitude and longitude ``(2,)`` [deg].

    Raises:
        ValueError: for other shapes, numbers that are not finite, or a latitude beyond a pole.
    """
    origin = finite_array("origin", origin, 2)
    degrees = np.concatenate([[origin], finite_array("places", places, "k", 2)])
    if (np.abs(degrees[:, 0]) > 90.0).any():
        far = degrees[np.abs(degrees[:, 0]).argmax(), 0]
        raise ValueError(f"latitudes must be within 90 degrees, got {far:g}")
    latitude, longitude = np.deg2rad(degrees).T
    sin, cos, east = np.sin(latitude), np.cos(latitude), longitude - longitude[0]
    radius = _SEMI_MAJOR_AXIS / np.sqrt(1.0 - _ECCENTRICITY_SQUARED * sin * sin)
    off_axis, along_axis = radius * cos, radius * (1.0 - _ECCENTRICITY_SQUARED) * sin
    outward = off_axis * np.cos(east) - off_axis[0]
    north = cos[0] * (along_axis - along_axis[0]) - sin[0] * outward
    return np.stack([north, off_axis * np.sin(east)], -1)[1:]
