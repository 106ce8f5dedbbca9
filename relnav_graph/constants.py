"""Physical constants, SI."""

#: Gravitational parameter of the Earth, m^3/s^2 (EGM2008; Pavlis et al. 2012).
MU_EARTH = 3.986004415e14

#: Equatorial radius of the Earth, m, and its zonal harmonics J2, J3, J4, tide-free
#: (EGM2008; Pavlis et al. 2012).
EARTH_RADIUS = 6378136.3
ZONAL_EARTH = (1.0826261738e-3, -2.5324105e-6, -1.6198976e-6)

#: Gravitational parameters of Sun and Moon, m^3/s^2 (DE440; Park et al. 2021).
MU_THIRD = {"sun": 1.32712440041279419e20, "moon": 4.902800118e12}

#: Of this package.
VERSION = "0.3.0"
