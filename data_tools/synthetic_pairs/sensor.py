"""From light to an 8-bit picture: blur, vignette, exposure, white balance, noise, tone curve."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

from data_tools.synthetic_pairs import noise


@dataclass(frozen=True)
class Sensor:
    """The camera settings of one capture."""

    exposure: float
    """Gain on linear light."""
    white_balance: tuple[float, float, float]
    noise: float
    """Standard deviation of the noise at mid-grey, in linear light (full scale = 1)."""
    blur_px: float
    """Standard deviation of the lens blur, in pixels."""
    vignette: float
    """Loss of light in the corners, 0 to 1."""

    def expose(
        self, radiance: Float32[np.ndarray, "h w 3"], seed: int
    ) -> UInt8[np.ndarray, "h w 3"]:
        """Take the picture; `seed` decides its noise."""
        light = cv2.GaussianBlur(radiance, (0, 0), self.blur_px) if self.blur_px > 0 else radiance
        gain = np.asarray(self.white_balance, np.float32) * np.float32(self.exposure)
        light = light * gain * self._falloff(*radiance.shape[:2])[..., None]
        index = np.arange(light.size, dtype=np.uint32).reshape(light.shape)
        shot = np.sqrt(np.maximum(light, 0) / np.float32(0.18) + np.float32(0.25))
        light = light + np.float32(self.noise) * shot * noise.bell(index, seed)
        return np.clip(np.rint(tone(light) * np.float32(255)), 0, 255).astype(np.uint8)

    def _falloff(self, height: int, width: int) -> np.ndarray:
        y = (np.arange(height, dtype=np.float32) + 0.5) / height * 2 - 1
        x = (np.arange(width, dtype=np.float32) + 0.5) / width * 2 - 1
        square = (x[None, :] ** 2 + y[:, None] ** 2) / 2
        return (1 - self.vignette * square).astype(np.float32)


def tone(light: np.ndarray) -> np.ndarray:
    """Linear light to display values: the sRGB curve with a soft shoulder above 0.7."""
    above = np.maximum(light - 0.7, 0)  # apart from where(), both of whose branches are computed
    soft = np.where(light > 0.7, 0.7 + 0.3 * (1 - 1 / (1 + above / 0.3)), light)
    soft = np.clip(soft, 0, 1)
    return np.where(soft <= 0.0031308, 12.92 * soft, 1.055 * soft ** (1 / 2.4) - 0.055)
