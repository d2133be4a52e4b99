"""Terms and small records that every layer shares: errors, shot, camera, colour, channels, blocks, keyed noise. No files, no Dask."""
