"""The workshop that trains the texture network and hands over an ONNX file. The only room that imports torch."""
