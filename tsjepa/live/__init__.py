"""The chain over a real socket: a device process, a controller process, and UDP datagrams between them.

Nothing here imports torch at its top, so that a device runs on numpy, onnxruntime and OpenCV alone.
"""
