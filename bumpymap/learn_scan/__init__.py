"""The workshop that trains the network for sectors of a scan and hands over an ONNX file. Imports torch, like learn."""
