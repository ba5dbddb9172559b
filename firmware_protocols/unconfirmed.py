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


ADIS16405_GYRO_FAULT_BITS = {"x": 12, "y": 11, "z": 10}
"""Bits of DIAG_STAT for a gyroscope axis that fails its self-test: z, y, x as in Linux.

The data sheet may have x, y, z. A unit with one axis known to be broken shows which.
"""

ADIS16405_DIAG_CLEARS_ON_READ = True
"""Whether reading DIAG_STAT clears it, so that a second read shows only what lasts.

Read it twice after one wrong SPI transfer.
"""

ADIS16405_OVER_RANGE = {"gyro": 1.0, "accel": 1.0, "mag": 1.4}
"""From which multiple of full scale on an axis counts as over range.

The numbers of 14 bits go on to 1.37 (gyroscope), 1.52 (accelerometer) and 1.64. Turn the sensor
ever faster and note the rate at which EA comes.
"""

ADIS16405_OUTPUT_DELAY_SAMPLES = 1
"""Samples between the last one that goes into an output and that output.

With the mean over the sample interval and the averager it makes (2 N + 1) / 2 samples for N taps
per stage, which one answer of the maker's support gives. A step of the rate beside an encoder
tells.
"""

ADIS16405_ANALOG_DELAY_S = 0.5e-3
"""Delay of the analog filters before the converter [s]; the same answer, and the same trial."""

ADIS16405_GYRO_OFFSET_BITS = 13
"""Bits of a gyroscope offset register: 13, where Linux takes 12. Write 0800 and see the sign."""

ADIS16405_SOFT_IRON_ONE = 0x0800
"""Soft-iron factor that means 1; one library takes 1FFF. Write 0400: the field halves if right."""

ADIS16405_SELF_TEST_RESPONSE = {"gyro_dps": 70.0, "accel_g": 0.35}
"""How far a self-test turns and pushes the sensors; any unit shows its own."""

ADIS16405_RESET_S = 0.17
"""How long a reset takes, by one source; time from the command to the first data-ready pulse."""

ADIS16405_SELF_TEST_S = 0.012
"""How long the internal self-test takes, by one source; time until its bit clears."""

ADIS16405_FLASH_S = 0.05
"""How long a flash update takes, from memory; data-ready pulses stop meanwhile."""

ADIS16405_PRECISION_AUTONULL_S = 30.0
"""How long the precise automatic zero averages, from memory; time until the offsets change."""

ADIS16405_SLEEP_UNIT_S = 0.5
"""Sleep per count of the low byte of SLP_CNT [s], from memory; write 02 and time the silence."""

ADIS16405_ALARM_SOURCES = 12
"""Alarm sources 1 to 12 are the words of a burst in order, from memory.

Set alarm 1 to "supply above 0" and see whether bit 8 of DIAG_STAT comes.
"""

XSENS_UT_PER_UNIT = 49.0
"""Nominal microtesla of one of the MTi's units of magnetic field, by one note of its maker.

The unit is the field where the sensor was calibrated, so it differs from sensor to sensor. Turn
the sensor about where the field is known: the mean length of its readings is the truth.
"""

XSENS_FRACTION_FIRST = True
"""Whether a number in the format 16.32 sends its fraction before its whole part, from memory.

At rest the accelerometer's z axis reads 9.8 if this is right.
"""

XSENS_LEGACY_AXES = 0x8
"""Axes of the earth of legacy orientations: north, west, up, from memory; one driver says ENU.

Lay the sensor level with its x axis to the north: the heading is 0 if this is right, 90 if ENU.
"""

XSENS_LEGACY_MATRIX_BY_COLUMNS = True
"""Whether a legacy matrix is sent column by column, from memory; those of MTData2 go by rows.

Turn the sensor a quarter turn to the left: the heading grows if this is right.
"""

XSENS_EULER_ORDER = "zyx"
"""Roll about x first, then pitch about y, then yaw about z, from memory; compare with a matrix."""

MS5803_RESET_S = 2.8e-3
"""How long an MS5803 reloads after a reset [s], from memory; read its PROM earlier and see."""

MS5803_LONGEST_CONVERSION_S = {
    256: 0.60e-3,
    512: 1.17e-3,
    1024: 2.28e-3,
    2048: 4.54e-3,
    4096: 9.04e-3,
}
"""Longest conversion at each oversampling [s], from memory. A read that is too early gives 0."""

MS5803_PRESSURE_NOISE_PA = {256: 13.0, 512: 8.4, 1024: 5.4, 2048: 3.6, 4096: 2.4}
"""Standard deviation of a pressure at each oversampling [Pa], from memory.

The last agrees with the maker's 20 cm. Let a barometer lie still for a minute and take the scatter.
"""

MS5803_TEMPERATURE_NOISE_C = {256: 0.012, 512: 0.008, 1024: 0.005, 2048: 0.003, 4096: 0.002}
"""The same of a temperature [degC], from memory."""

MS5803_EARLY_READ = 0
"""What a read before the end of a conversion gives, or a second one after it; from memory."""

MMA7260_G_SELECT = {0: (1.5, 800.0), 1: (2.0, 600.0), 2: (4.0, 300.0), 3: (6.0, 200.0)}
"""Range [g] and sensitivity [mV/g at 3.3 V] by the pins g-Select2 and g-Select1 as one number.

The figures are sure, the order of the two pins is not: if it is the other way round, 1 and 2
change places, and a sensor at rest reads 2 g or 0.5 g there.
"""

MMA7260_SENSITIVITY_TOLERANCE = 0.075
MMA7260_CROSS_AXIS = 0.05
MMA7260_ZERO_TOLERANCE_V = 0.165
"""Share of the sensitivity, of the other axes, and volts off the middle at 3.3 V, from memory."""

MMA7260_BANDWIDTH_HZ = (350.0, 350.0, 150.0)
MMA7260_NOISE_UG = 350.0
"""Bandwidth of the three axes and noise density [ug per root hertz], from memory.

The scatter of a sensor at rest, sampled at 100 Hz, is 8 mg in x and y if both are right.
"""

MMA7260_SWING_V = 0.25
"""The output stays so far from ground and supply [V], from memory.

Shake it hard at +-6 g: that is where the readings stop.
"""

XSENS_MTI_NOISE = {
    "xsens-mti": {"gyro_dps": 0.01, "accel_ug": 80.0, "mag_ut": 0.05},
    "xsens-mti-legacy": {"gyro_dps": 0.05, "accel_ug": 200.0, "mag_ut": 0.05},
}
"""White noise per root hertz of the two generations, and of one sample of the magnetic field.

Typical figures of their data sheets, from memory. A still recording and `imu-rig noise` tell.
"""

XSENS_MTI_RANGE = {
    "xsens-mti": {"accel": 50.0, "gyro_dps": 450.0},
    "xsens-mti-legacy": {"accel": 50.0, "gyro_dps": 300.0},
}
"""Full scale of the standard versions [m/s2, deg/s], from memory; units are sold with others."""

MAESTRO_PRODUCTS = {
    0x0089: "Micro Maestro 6",
    0x008A: "Mini Maestro 12",
    0x008B: "Mini Maestro 18",
    0x008C: "Mini Maestro 24",
}
"""Boards by their USB product number; that of the Mini 24 is from memory. Plug one in and list."""

MAESTRO_COMMAND_INTERFACE = 0
"""USB interface of a Maestro's command port, from memory; its TTL port is 2.

The port whose name below /dev/serial/by-id ends so answers a question if this is right.
"""

USB_ADAPTERS: dict[tuple[int, int | None], str] = {
    (0x0403, None): "FTDI adapter",
    (0x10C4, 0xEA60): "CP210x adapter",
    (0x1A86, None): "CH34x adapter",
    (0x067B, None): "Prolific adapter",
    (0x2341, None): "Arduino board",
    (0x239A, None): "Adafruit board",
    (0x2E8A, None): "Raspberry Pi Pico",
    (0x303A, None): "Espressif board",
    (0x0483, 0x5740): "STM32 board",
    (0x2639, None): "Xsens device",
    (0x26AC, None): "PX4 flight controller",
    (0x1209, 0x5741): "ArduPilot flight controller",
}
"""What a USB vendor and product are, from memory; product None stands for all of a vendor's.

Only words on a screen rest on it. Plug one in and see whether `imu-rig devices` names it rightly.
"""

ICM20602_BIAS_MG = (25.0, 25.0, 40.0)
ICM20602_BIAS_DPS = 1.0
ICM20602_CROSS_AXIS = 0.02
"""What the ICM-20602 of many flight controllers reads of nothing, and of other axes, from memory.

Its noise and its sensitivity are those of the data sheet's first page. A flight controller whose
own calibration was taken out, at rest on six sides, tells; with it in, the errors are smaller.
"""

XSENS_TEMPERATURE_HZ = 10
"""Messages per second with a temperature that an MTi of the later generations sends at most.

What the maker's program asked an MTi-300 for; its driver in ROS says 1. The answer to
SetOutputConfiguration tells.
"""

MAVLINK_CUT_OFF = 0.5
"""How much whole numbers of SCALED_IMU and RAW_IMU lie nearer to zero than what was measured.

The sources of ArduPilot and PX4 convert floats to whole numbers, which cuts them off: a value
between 3 and 4 is sent as 3 and most likely was 3.5. Firmware that rounds would need 0 here. On it,
with an axis up and then down, half the difference of the readings reads 1 mg above gravity.
"""
