"""Train the texture network and the scan network and write them as ONNX files. Needs the extra ``learn``."""
