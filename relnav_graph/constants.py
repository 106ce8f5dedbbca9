"""Physical constants, SI."""

#: Gravitational parameter of the Earth, m^3/s^2 (EGM2008; Pavlis et al. 2012).
MU_EARTH = 3.986004415e14

#: Equatorial radius of the Earth, m, and its zonal harmonics J2, J3, J4, tide-free
#: (EGM2008; Pavlis et al. 2012).
EARTH_RADIUS = 6378136.3
ZONAL_EARTH = (1.0826261738e-3, -2.5324105e-6, -1.6198976e-6)

#: Of this package.
VERSION = "0.3.0"
