"""Time, memory and operations of networks over the sizes of scenes and images (`benchmark=cost`)."""
