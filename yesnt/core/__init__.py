"""Terms and records that all layers share: errors, shot, camera, colour, channels, blocks, noise. No files, no Dask."""
