import cv2
import numpy as np


def sobel(image, window, out):
    """Write the length of Sobel's gradient, which is then averaged over the window."""
    out[:] = np.hypot(cv2.Sobel(image, -1, 1, 0), cv2.Sobel(image, -1, 0, 1))
