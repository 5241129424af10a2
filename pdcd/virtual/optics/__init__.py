"""What a camera sees of a mock bench whose devices lie anywhere, out of pixels of both panels."""
