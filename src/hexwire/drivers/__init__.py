"""Robot drivers: joints and SI units above, sessions and frames below."""
