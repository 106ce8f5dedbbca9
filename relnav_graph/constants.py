"""Physical constants, SI."""

#: Gravitational parameter of the Earth, m^3/s^2 (EGM2008; Pavlis et al. 2012).
MU_EARTH = 3.986004415e14
