"""Open Image Denoise's interface in Python, in pyoidn's shape, with stillray behind it.

``import stillray.oidn as pyoidn`` runs code that was written for pyoidn; `docs/oidn.md` says what
is the same, what differs and what is refused. ``python -m stillray.oidn`` is `oidnDenoise`.
"""

from stillray.oidn import version
from stillray.oidn.buffer import Buffer
from stillray.oidn.constants import (
    OIDN_DEVICE_TYPE_CPU,
    OIDN_DEVICE_TYPE_CUDA,
    OIDN_DEVICE_TYPE_DEFAULT,
    OIDN_DEVICE_TYPE_HIP,
    OIDN_DEVICE_TYPE_METAL,
    OIDN_DEVICE_TYPE_SYCL,
    OIDN_FILTER_TYPE_RT,
    OIDN_FILTER_TYPE_RT_LIGHTMAP,
    OIDN_FORMAT_FLOAT,
    OIDN_FORMAT_FLOAT2,
    OIDN_FORMAT_FLOAT3,
    OIDN_FORMAT_FLOAT4,
    OIDN_FORMAT_HALF,
    OIDN_FORMAT_HALF2,
    OIDN_FORMAT_HALF3,
    OIDN_FORMAT_HALF4,
    OIDN_FORMAT_UNDEFINED,
    OIDN_IMAGE_ALBEDO,
    OIDN_IMAGE_COLOR,
    OIDN_IMAGE_NORMAL,
    OIDN_IMAGE_OUTPUT,
    OIDN_QUALITY_BALANCED,
    OIDN_QUALITY_DEFAULT,
    OIDN_QUALITY_FAST,
    OIDN_QUALITY_HIGH,
    OIDN_STORAGE_DEVICE,
    OIDN_STORAGE_HOST,
    OIDN_STORAGE_MANAGED,
    OIDN_STORAGE_UNDEFINED,
)
from stillray.oidn.convenience import denoise
from stillray.oidn.device import Device
from stillray.oidn.filter import Filter

__all__ = [
    "OIDN_DEVICE_TYPE_CPU",
    "OIDN_DEVICE_TYPE_CUDA",
    "OIDN_DEVICE_TYPE_DEFAULT",
    "OIDN_DEVICE_TYPE_HIP",
    "OIDN_DEVICE_TYPE_METAL",
    "OIDN_DEVICE_TYPE_SYCL",
    "OIDN_FILTER_TYPE_RT",
    "OIDN_FILTER_TYPE_RT_LIGHTMAP",
    "OIDN_FORMAT_FLOAT",
    "OIDN_FORMAT_FLOAT2",
    "OIDN_FORMAT_FLOAT3",
    "OIDN_FORMAT_FLOAT4",
    "OIDN_FORMAT_HALF",
    "OIDN_FORMAT_HALF2",
    "OIDN_FORMAT_HALF3",
    "OIDN_FORMAT_HALF4",
    "OIDN_FORMAT_UNDEFINED",
    "OIDN_IMAGE_ALBEDO",
    "OIDN_IMAGE_COLOR",
    "OIDN_IMAGE_NORMAL",
    "OIDN_IMAGE_OUTPUT",
    "OIDN_QUALITY_BALANCED",
    "OIDN_QUALITY_DEFAULT",
    "OIDN_QUALITY_FAST",
    "OIDN_QUALITY_HIGH",
    "OIDN_STORAGE_DEVICE",
    "OIDN_STORAGE_HOST",
    "OIDN_STORAGE_MANAGED",
    "OIDN_STORAGE_UNDEFINED",
    "Buffer",
    "Device",
    "Filter",
    "denoise",
    "version",
]
