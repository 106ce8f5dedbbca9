"""Factor-graph smoothing for spacecraft relative navigation, compared with Kalman filters.

Conventions
-----------
- SI units and radians inside. Degrees, arc-seconds, deg/h exist only in scenario files
  (as strings with their unit) and in tables for people.
- The *target* (chief) is the tumbling body; the *chaser* (deputy) carries the sensors.
- Frames: ``i`` inertial, ``o`` orbital frame of the target = RTN (x radial outward,
  y transverse, z along the orbit normal), ``t`` target body, ``c`` chaser body, ``s``
  sensor. A scenario without an orbit takes a frame that does not rotate as ``o``.
- ``R_ab`` takes b-components to a-components. ``r_tc_o`` is the position of c relative to
  t in o-components. ``w_ti_t`` is the rate of t relative to i in t-components.
- Perturbations act on the right: ``R = R_hat Exp(d)``, d in the right-hand frame of R.
  Filter, smoother, covariances and NEES all use it.
- Quaternions appear in files only: Hamilton, scalar first, ``q_wxyz``, w >= 0.
- Residuals are prediction minus measured.
- ``*_density`` is a continuous noise (unit/sqrt(Hz)), ``*_sigma`` one per sample.
- ``P_*`` is a covariance, ``sigma_*`` a standard deviation.
- Time is float seconds since the scenario's epoch; the time of a measurement is when it
  was valid. An input sample (gyro, velocity) is the mean over the interval it states.
- Random numbers come from ``SeedSequence(root, spawn_key=(run, stream))`` only, one
  stream per sensor.
- Of an inertia only the ratios are observable: l_x = (J_y - J_z) / J_x and cyclic.
"""

__version__ = "0.1.0"
