"""Facts that code relies on and no two independent sources confirm, in one place.

Each says what is uncertain and how hardware would show it.
"""

MS5803_01BA_COLD_SENS = 2
"""Factor of the 01BA's SENS2 below -15 degC: 2 in one public driver, 3 in another.

A 01BA at -20 degC beside a reference barometer: the two differ there by 0.1 mbar or more.
"""

MS5803_01BA_HOT_SENS = (-1, 3)
"""Factor and shift of the 01BA's SENS2 above 45 degC, over (TEMP - 4500)**2.

One public driver; another takes (TEMP + 1500)**2, which makes a step at 45 degC that no sensor
has. A 01BA warmed past 45 degC at one pressure shows no step if this is right.
"""
