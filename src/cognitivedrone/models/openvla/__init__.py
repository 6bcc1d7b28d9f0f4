"""OpenVLA-7B (Kim et al. 2024, arXiv 2406.09246) in plain modules, with an action of four numbers.

    config.py      the sizes, and the published config.json
    tensors.py     names and shapes of the published tensors, and their names here
    prepare.py     from pixels and text to the network's inputs
    actions.py     velocities to 256 bins on the last tokens of the vocabulary, and back
    network.py     towers, projector and Llama in one network; logits, loss
    decode.py      one control step: autoregressive, or all actions of a chunk in parallel
    checkpoint.py  all checks of a folder before anything heavy is loaded
    weights.py     tensors from files to a network, and back; weight-only quantisation

The first four and `checkpoint` need no PyTorch.
"""
