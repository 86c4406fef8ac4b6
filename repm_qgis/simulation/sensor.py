"""A linear-array pushbroom satellite: circular orbit, steady attitude with a small wobble, one detector line.

Coordinates are Earth-centred and Earth-fixed (ECEF, WGS 84, metres). The Earth's rotation during an image's second or
so is neglected, which changes the image's shear and nothing that an RPC could not describe. Pixels are columns and rows
of pixel centres, and the first pixel's centre is (0, 0); row r is exposed (r - (rows - 1) / 2) line periods after the
middle. Columns grow to the left of the flight, so that an image is never mirrored.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Sequence, Tuple

import numpy as np

from ..contracts.arrays import FloatArray
from ..contracts.errors import OptionError
from ..geometry.frames import ecef_from_geodetic, geodetic_from_ecef

EARTH_GM = 3.986004418e14  # m^3 / s^2
_STEPS = 30  # at most; far more than these iterations need
_TOLERANCE_PX = 1e-9


@dataclass(frozen=True)
class JitterSine:
    """One sine of an attitude that shakes: px of the detector by which lines look aside, over the lines of the image.

    ``amplitudes_px`` are those in the direction of columns and of rows, ``phases_rad`` those at the first line. Along
    the lines the camera tilts forwards and backwards: the content of a line then lies this much farther back in the
    image.
    """

    period_lines: float
    amplitudes_px: Tuple[float, float]
    phases_rad: Tuple[float, float]


def jitter_px(sines: Sequence[JitterSine], rows: FloatArray) -> FloatArray:
    """(N, 2) px in columns and rows by which jitter moves what is seen in lines (N,)."""
    moved = np.zeros((np.size(rows), 2))
    for sine in sines:
        angle = 2 * np.pi * np.ravel(rows)[:, None] / sine.period_lines + np.array(sine.phases_rad)
        moved += np.array(sine.amplitudes_px) * np.sin(angle)
    return moved


@dataclass(frozen=True)
class Look:
    """How one view is taken: pitch (forward is positive) and roll in degrees at the satellite, GSD on the ground."""

    pitch_deg: float
    gsd_m: float
    roll_deg: float = 0.0


@dataclass(frozen=True)
class Sensor:
    """A satellite's camera. Its noise variance is ``read_noise_dn`` squared plus ``photon_gain`` times the signal."""

    name: str
    altitude_m: float
    looks: Tuple[Look, ...]
    detectors: int = 30000  # length of the detector line
    wobble_rad: float = 1e-6  # amplitude of the oscillation of each attitude angle
    wobble_periods_s: Tuple[float, ...] = (3.1, 5.3, 11.7)
    distortion_px: float = 0.8  # bend of the detector line at its ends
    blur_px: float = 0.57  # deviation of the point spread; with the pixel's aperture, an MTF of 0.13 at Nyquist
    read_noise_dn: float = 3.0
    photon_gain: float = 0.05
    bits: int = 12

    def at_gsd(self, gsd_m: float) -> Sensor:
        """The same camera with another ground sampling distance in all its looks."""
        return replace(self, looks=tuple(replace(look, gsd_m=gsd_m) for look in self.looks))


PLEIADES = Sensor("PLEIADES", 694e3, (Look(12.0, 0.5), Look(0.0, 0.5, 2.0), Look(-12.0, 0.5)))
ZY3 = Sensor("ZY3", 506e3, (Look(22.0, 2.5), Look(0.0, 2.1), Look(-22.0, 2.5)), detectors=24576)
GF7 = Sensor("GF7", 506e3, (Look(26.0, 0.8), Look(-5.0, 0.65)), detectors=30720)
PRESETS = {sensor.name: sensor for sensor in (PLEIADES, ZY3, GF7)}


@dataclass(frozen=True)
class PushbroomView:
    """One image's rigorous sensor model. Build it with :func:`aim`.

    ``along, across, up`` are the orbit's axes in ECEF when the middle line is exposed; ``orbital_from_body`` (3, 3)
    turns the camera's axes (forward, right, boresight) into the orbital ones (forward, right, down). ``jitter`` are
    waves of the attitude that an RPC cannot describe: ``steady`` is the view without them.
    """

    name: str
    sensor: Sensor
    look: Look
    size: Tuple[int, int]
    along: Tuple[float, float, float]
    across: Tuple[float, float, float]
    up: Tuple[float, float, float]
    radius_m: float
    orbital_from_body: Tuple[Tuple[float, float, float], ...]
    ifov_rad: float
    line_period_s: float
    phases: Tuple[Tuple[float, ...], ...]
    jitter: Tuple[JitterSine, ...] = ()

    @property
    def steady(self) -> PushbroomView:
        """The view without jitter: what the vendor's RPC is fitted to."""
        return replace(self, jitter=())

    def _time(self, row: FloatArray) -> FloatArray:
        return (np.asarray(row, dtype=np.float64) - (self.size[1] - 1) / 2) * self.line_period_s

    def _axes(self, time: FloatArray) -> Tuple[FloatArray, FloatArray]:
        """(N, 3) unit vectors at times: outwards to the satellite, and forward."""
        angle = (math.sqrt(EARTH_GM / self.radius_m**3) * time)[:, None]
        up, along = np.array(self.up), np.array(self.along)
        return up * np.cos(angle) + along * np.sin(angle), along * np.cos(angle) - up * np.sin(angle)

    def _wobble(self, time: FloatArray) -> FloatArray:
        """(N, 3) small rotation vectors of the camera at times, rad."""
        rotation = np.zeros((time.size, 3))
        periods = self.sensor.wobble_periods_s
        for axis, phases in enumerate(self.phases):
            for period, phase in zip(periods, phases):
                rotation[:, axis] += np.sin(2 * np.pi * time / period + phase)
        return rotation * (self.sensor.wobble_rad / max(len(periods), 1))

    def _detector(self, pixels: FloatArray) -> Tuple[FloatArray, FloatArray]:
        """Tangents of the look angles of pixels (N, 2) in the camera: forward and right."""
        offset = pixels[:, 0] - (self.size[0] - 1) / 2
        place = offset / (self.sensor.detectors / 2)
        bend = self.sensor.distortion_px * self.ifov_rad
        forward, right = 0.5 * bend * place**2, -(offset * self.ifov_rad + bend * place**3)
        if self.jitter:
            # Columns grow to the left and rows against the flight: what is seen moves by + jitter px in the image.
            moved = jitter_px(self.jitter, pixels[:, 1]) * self.ifov_rad
            forward, right = forward - moved[:, 1], right + moved[:, 0]
        return forward, right

    def rays(self, col_row: FloatArray) -> Tuple[FloatArray, FloatArray]:
        """Where the satellite is and where each pixel looks: (N, 3) ECEF positions and unit directions."""
        pixels = np.asarray(col_row, dtype=np.float64)
        time = self._time(pixels[:, 1])
        forward, right = self._detector(pixels)
        body = np.stack([forward, right, np.ones_like(right)], axis=1)
        body += np.cross(self._wobble(time), body)
        orbital = body @ np.array(self.orbital_from_body).T
        up, along = self._axes(time)
        direction = orbital[:, :1] * along + orbital[:, 1:2] * np.array(self.across) - orbital[:, 2:] * up
        return up * self.radius_m, direction / np.linalg.norm(direction, axis=1, keepdims=True)

    def localise(self, col_row: FloatArray, height: FloatArray | float) -> FloatArray:
        """(N, 3) longitudes and latitudes (degrees) that pixels (N, 2) see at heights (m), and these heights."""
        position, direction = self.rays(col_row)
        heights = np.broadcast_to(np.asarray(height, dtype=np.float64), position.shape[:1])
        reach = np.full(heights.shape, self.sensor.altitude_m)
        for _ in range(_STEPS):
            point = position + reach[:, None] * direction
            ground = geodetic_from_ecef(point)
            lon, lat = np.radians(ground[:, 0]), np.radians(ground[:, 1])
            normal = np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=1)
            step = (ground[:, 2] - heights) / -np.einsum("ni,ni->n", normal, direction)
            if np.abs(step).max(initial=0.0) < 1e-7:
                break
            reach = reach + step
        ground[:, 2] = heights
        return ground

    def project(self, lon_lat_h: FloatArray) -> FloatArray:
        """(N, 2) columns and rows at which ground points are seen, visible or not.

        ``lon_lat_h`` is (N, 3): degrees, degrees, metres above the WGS 84 ellipsoid.
        """
        ground = ecef_from_geodetic(np.asarray(lon_lat_h, dtype=np.float64))
        middle = np.array([(self.size[0] - 1) / 2, (self.size[1] - 1) / 2])
        pixels = np.tile(middle, (ground.shape[0], 1))
        # The miss of a point is nearly linear in the row; its slope at the middle serves all.
        centre = self.rays(middle[None])
        aim = centre[0] + self.sensor.altitude_m * centre[1]
        slope = self._miss(aim, middle[None] + [0.0, 1.0])[0, 1] - self._miss(aim, middle[None])[0, 1]
        for _ in range(_STEPS):
            miss = self._miss(ground, pixels)
            step = np.stack([miss[:, 0], -miss[:, 1] / slope], axis=1)
            pixels += step
            if np.abs(step).max(initial=0.0) < _TOLERANCE_PX:
                break
        return pixels

    def _miss(self, ground: FloatArray, pixels: FloatArray) -> FloatArray:
        """(N, 2) how far points lie from the rays of pixels, in px of the detector: right to left, forward."""
        time = self._time(pixels[:, 1])
        up, along = self._axes(time)
        sight = ground - up * self.radius_m
        ahead, below = np.einsum("ni,ni->n", sight, along), -np.einsum("ni,ni->n", sight, up)
        orbital = np.stack([ahead, sight @ np.array(self.across), below], axis=1)
        body = orbital @ np.array(self.orbital_from_body)
        body = body - np.cross(self._wobble(time), body)
        forward, right = self._detector(pixels)
        seen = body[:, :2] / body[:, 2:]
        miss: FloatArray = np.stack([right - seen[:, 1], seen[:, 0] - forward], axis=1) / self.ifov_rad
        return miss


def _rotated(vector: FloatArray, axis: FloatArray, angle: float) -> FloatArray:
    """Rodrigues' rotation of a vector about a unit axis."""
    turned: FloatArray = vector * math.cos(angle) + np.cross(axis, vector) * math.sin(angle)
    turned += axis * (axis @ vector) * (1 - math.cos(angle))
    return turned


def _camera_axes(sight: FloatArray) -> FloatArray:
    """(3, 3) orbital_from_body of a camera whose boresight is the unit vector ``sight`` of the orbital frame."""
    right = np.cross(sight, [1.0, 0.0, 0.0])
    right /= np.linalg.norm(right)
    axes: FloatArray = np.stack([np.cross(right, sight), right, sight], axis=1)
    return axes


def aim(
    sensor: Sensor,
    look: Look,
    target: Sequence[float],
    *,
    size: Tuple[int, int],
    heading_deg: float,
    seed: int,
    name: str,
) -> PushbroomView:
    """Point a camera so that the middle of its image sees ``target``: longitude, latitude (degrees), height (m).

    ``heading_deg`` is the direction of flight over the target, clockwise from north; ``seed`` that of the attitude
    wobble. Raises OptionError for a look that misses the Earth.
    """
    lon, lat = math.radians(target[0]), math.radians(target[1])
    ground = ecef_from_geodetic(np.array([target], dtype=np.float64))[0]
    radius = float(np.linalg.norm(ground))
    orbit = radius + sensor.altitude_m
    up = ground / radius
    east = np.array([-math.sin(lon), math.cos(lon), 0.0])
    north = np.array([-math.sin(lat) * math.cos(lon), -math.sin(lat) * math.sin(lon), math.cos(lat)])
    flight = north * math.cos(math.radians(heading_deg)) + east * math.sin(math.radians(heading_deg))
    along = flight - up * (flight @ up)
    along /= np.linalg.norm(along)
    arcs = []
    for angle in (math.radians(look.pitch_deg), math.radians(look.roll_deg)):
        if not abs(math.sin(angle)) * orbit < radius * 0.95:
            raise OptionError("look", look, "must meet the Earth well before its horizon")
        arcs.append(math.asin(orbit / radius * math.sin(angle)) - angle)
    # To look right by the roll, the satellite flies left of the target; to look ahead by the pitch, before it.
    up = _rotated(up, along, -arcs[1])
    across = np.cross(along, up)
    up, along = (up * math.cos(arcs[0]) - along * math.sin(arcs[0]), along * math.cos(arcs[0]) + up * math.sin(arcs[0]))
    sight = ground - up * orbit
    distance = float(np.linalg.norm(sight))
    sight = np.array([sight @ along, sight @ across, -(sight @ up)]) / distance
    line_period = look.gsd_m / (math.sqrt(EARTH_GM / orbit**3) * radius)
    phases = np.random.default_rng(seed).uniform(0, 2 * np.pi, (3, len(sensor.wobble_periods_s)))
    turned, wobble = (tuple(map(tuple, rows)) for rows in (_camera_axes(sight), phases))
    return PushbroomView(
        name=name,
        sensor=sensor,
        look=look,
        size=size,
        along=tuple(along),
        across=tuple(across),
        up=tuple(up),
        radius_m=orbit,
        orbital_from_body=turned,
        ifov_rad=look.gsd_m / distance,
        line_period_s=line_period,
        phases=wobble,
    )
