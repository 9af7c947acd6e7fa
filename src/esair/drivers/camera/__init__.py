"""Cameras that the kernel knows as video devices, by OpenCV.

::

    [sensor.front]
    driver = "camera"
    device = "usb:046d:0825"      # or a path, or the beginning of its name
    width = 640
    height = 480
    fps = 30

    pip install 'esair[camera]'

A reading is a `numpy.ndarray` of ``uint8`` with the shape ``(height, width, 3)``, the top
row first; its colours are blue, green, red (``colors="bgr"``, as OpenCV has them), red,
green, blue (``"rgb"``), or it has the shape ``(height, width)`` (``"gray"``). It cannot be
written: everybody who reads the sensor has the same one; take ``frame.copy()``.

Source: the kernel's ``Documentation/userspace-api/media/v4l``; OpenCV's ``VideoCapture``.
"""

from esair.drivers.camera._find import devices, find_camera, toml
from esair.drivers.camera._sensor import Camera, CameraLink, CameraRequest

__all__ = ["Camera", "CameraLink", "CameraRequest", "devices", "find_camera", "toml"]
