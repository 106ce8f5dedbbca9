"""Messages of the CCSDS with orbits and attitudes: OEM (502.0-B) and AEM (504.0-B)."""
