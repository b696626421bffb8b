"""Motion: a curve of time in plain numbers, with exact derivatives."""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import cos, pi, sin

from ..checks import number


@dataclass(frozen=True)
class Motion:
    """start + speed·t + amplitude·sin(2π·frequency·t + phase): a curve that a file can hold and a process can send.

    Serves as the curve of a :class:`Drive`, the target of a :class:`Servo` or a torque of :class:`JointTorque`.

    Parameters
    ----------
    start : float
        rad or m (N·m or N of a torque).
    speed : float
        Per second.
    amplitude : float
        In the unit of `start`.
    frequency : float
        Hz.
    phase : float
        rad.

    Raises
    ------
    InputError
        A number that is none, or not finite.
    """

    start: float = 0.0
    speed: float = 0.0
    amplitude: float = 0.0
    frequency: float = 0.0
    phase: float = 0.0

    def __post_init__(self):
        for each in fields(self):
            object.__setattr__(self, each.name, number(getattr(self, each.name), f"motion: {each.name}"))

    @property
    def numbers(self) -> tuple[float, ...]:
        """The five numbers: (start, speed, amplitude, frequency, phase)."""
        return tuple(getattr(self, each.name) for each in fields(self))

    def __call__(self, t: float) -> float:
        return self.start + self.speed * t + self.amplitude * sin(2 * pi * self.frequency * t + self.phase)

    def rate(self, t: float) -> float:
        """The derivative by time.

        Parameters
        ----------
        t : float
            Time, s.

        Returns
        -------
        float
            rad/s or m/s; per second, whatever the unit of ``start``.
        """
        w = 2 * pi * self.frequency
        return self.speed + self.amplitude * w * cos(w * t + self.phase)

    def acceleration(self, t: float) -> float:
        """The second derivative by time.

        Parameters
        ----------
        t : float
            Time, s.

        Returns
        -------
        float
            rad/s² or m/s²; per second squared, whatever the unit of ``start``.
        """
        w = 2 * pi * self.frequency
        return -self.amplitude * w**2 * sin(w * t + self.phase)
