import torch

torch.set_num_threads(1)  # the models of these tests are too small for more
