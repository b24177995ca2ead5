"""Devices of a scene file: the keys of camera, projector and detector, and of data sheets."""
