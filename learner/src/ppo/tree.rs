//! Gradients of shards, added in an order that knows only shards: neighbours, then neighbouring pairs, and so on.
//!
//! ```text
//! shards     0   1   2   3   4   5   6   7
//!            └─┬─┘   └─┬─┘   └─┬─┘   └─┬─┘
//! nodes        └───┬───┘       └───┬───┘       one learner ends with the root, two with these two, …
//!                  └───────┬───────┘
//! ```
//! Shards and learners are powers of two, so each learner's shards have a node of their own. Learners then add their nodes
//! as the tree goes on. A leaf begins as +0 and two numbers add up to −0 only if both are −0, so no node has a −0, and
//! adding zeros changes no bit of it.

use crate::peers::{PeerError, Peers};
use tch::Tensor;

/// The sum of leaves that come in order. It keeps no more nodes than one a level.
#[derive(Debug, Default)]
pub(crate) struct Tree {
    /// Level and sum, the levels falling.
    nodes: Vec<(u32, Tensor)>,
}

impl Tree {
    /// Adds the next leaf. Takes its memory.
    pub(crate) fn add(&mut self, leaf: Tensor) {
        let (mut level, mut sum) = (0, leaf);
        while let Some((_, mut left)) = self.nodes.pop_if(|(other, _)| *other == level) {
            let _ = left.g_add_(&sum);
            (level, sum) = (level + 1, left);
        }
        self.nodes.push((level, sum));
    }

    /// The sum of all leaves, whose number is a power of two. Panics if it is not.
    pub(crate) fn root(mut self) -> Tensor {
        let (_, root) = self.nodes.pop().expect("a tree has leaves");
        assert!(self.nodes.is_empty(), "the leaves are a power of two");
        root
    }

    /// The root of all learners' trees, on each of them.
    pub(crate) fn over(self, peers: &Peers) -> Result<Tensor, PeerError> {
        let mut own = self.root();
        // Two learners' nodes are the last two, and a sum of two numbers has one order.
        if peers.count() <= 2 {
            peers.sum_gradients(&mut own)?;
            return Ok(own);
        }
        let nodes = peers.gather_gradients(&own)?;
        let mut upper = Self::default();
        for rank in 0..nodes.size()[0] {
            upper.add(nodes.select(0, rank));
        }
        // A gradient's memory is its own: that of the other nodes is free then.
        Ok(upper.root().copy())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::to_vec;
    use proptest::prelude::*;

    /// Numbers whose sum depends on the order: large ones that cancel, small ones that vanish beside them.
    fn leaf() -> impl Strategy<Value = Vec<f32>> {
        let number = (-1.0f32..1.0, -30i32..30).prop_map(|(part, exponent)| part * 2f32.powi(exponent));
        proptest::collection::vec(number, 5)
    }

    fn sum(leaves: &[Vec<f32>]) -> Tensor {
        let mut tree = Tree::default();
        for leaf in leaves {
            tree.add(Tensor::from_slice(leaf));
        }
        tree.root()
    }

    fn bits(tensor: &Tensor) -> Vec<u32> {
        to_vec(tensor).into_iter().map(f32::to_bits).collect()
    }

    proptest! {
        /// However the leaves are divided among learners, the root has the same bits.
        #[test]
        fn the_root_knows_no_learners(leaves in proptest::collection::vec(leaf(), 16), shards in 0u32..5) {
            let leaves = &leaves[..1 << shards];
            let whole = bits(&sum(leaves));
            for learners in 0..=shards {
                let mut upper = Tree::default();
                for own in leaves.chunks(leaves.len() >> learners) {
                    upper.add(sum(own));
                }
                prop_assert_eq!(bits(&upper.root()), whole.clone(), "{} learners", 1 << learners);
            }
        }
    }

    #[test]
    fn neighbours_are_added_first() {
        let leaves = [1e8, 1.0, -1e8, 1.0].map(|number: f32| vec![number]);
        // (1e8 + 1) + (−1e8 + 1); one after the other would give 1.
        assert_eq!(to_vec(&sum(&leaves)), [0.0]);
    }
}
