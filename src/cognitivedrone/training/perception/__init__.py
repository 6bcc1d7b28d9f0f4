"""What reading panels is trained with: crops of label pictures, their attribute values, what a reader makes of them."""
