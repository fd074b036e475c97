"""Time, memory and operations of networks over scene and image sizes (`benchmark=cost` and `benchmark=gpu`)."""
