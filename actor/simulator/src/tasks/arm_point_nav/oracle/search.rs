//! A* (Hart, Nilsson, Raphael 1968) over actions of equal cost.
//!
//! Lazy: whether an action really leads from a state to the next is only asked when the next state's turn has come,
//! because the answer is a collision query and most states never have their turn. The search hands out one state after
//! the other, so that the caller decides what a goal is.

use crate::robot::action::Action;
use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashSet};

pub trait Graph {
    type State: Copy;

    fn key(&self, state: &Self::State) -> u64;

    /// Fills `out` with the actions that can be tried in a state and where they would lead.
    fn successors(&self, state: &Self::State, out: &mut Vec<(Action, Self::State)>);

    fn passable(&self, from: &Self::State, action: Action, to: &Self::State) -> bool;

    /// Fewest actions from a state to any goal: never more than there are (admissible), and never less by two for one
    /// action (consistent).
    fn bound(&self, state: &Self::State) -> u32;
}

#[derive(Clone, Copy)]
struct Node<S> {
    state: S,
    parent: Option<(usize, Action)>,
    cost: u32,
}

pub struct Search<S> {
    nodes: Vec<Node<S>>,
    // Least bound first; of those the one that has come furthest; of those the oldest.
    open: BinaryHeap<Reverse<(u32, Reverse<u32>, usize)>>,
    // Only asked for membership: its order, which differs between runs, is never seen.
    closed: HashSet<u64>,
    successors: Vec<(Action, S)>,
    expansions_left: u32,
}

impl<S: Copy> Search<S> {
    /// A search from `start` that expands at most `expansions` states.
    pub fn new(graph: &impl Graph<State = S>, start: S, expansions: u32) -> Self {
        let mut search = Self {
            nodes: Vec::new(),
            open: BinaryHeap::new(),
            closed: HashSet::new(),
            successors: Vec::new(),
            expansions_left: expansions,
        };
        search.push(graph, Node { state: start, parent: None, cost: 0 });
        search
    }

    fn push(&mut self, graph: &impl Graph<State = S>, node: Node<S>) {
        let total = node.cost.saturating_add(graph.bound(&node.state));
        self.open.push(Reverse((total, Reverse(node.cost), self.nodes.len())));
        self.nodes.push(node);
    }

    /// The next state in the order of cost plus bound, each once; none when all have been seen or the limit is reached.
    pub fn next(&mut self, graph: &impl Graph<State = S>) -> Option<usize> {
        while let Some(Reverse((_, _, index))) = self.open.pop() {
            let Node { state, parent, cost } = self.nodes[index];
            let key = graph.key(&state);
            if self.closed.contains(&key) {
                continue;
            }
            if let Some((from, action)) = parent
                && !graph.passable(&self.nodes[from].state, action, &state)
            {
                continue;
            }
            self.closed.insert(key);
            self.expansions_left = self.expansions_left.checked_sub(1)?;
            let mut successors = std::mem::take(&mut self.successors);
            successors.clear();
            graph.successors(&state, &mut successors);
            for &(action, next) in &successors {
                if !self.closed.contains(&graph.key(&next)) {
                    self.push(graph, Node { state: next, parent: Some((index, action)), cost: cost + 1 });
                }
            }
            self.successors = successors;
            return Some(index);
        }
        None
    }

    /// A state that `next` has handed out.
    pub fn state(&self, index: usize) -> &S {
        &self.nodes[index].state
    }

    /// Actions from the start to it.
    pub fn cost(&self, index: usize) -> u32 {
        self.nodes[index].cost
    }

    pub fn path(&self, index: usize) -> Vec<Action> {
        let mut actions = Vec::new();
        let mut at = index;
        while let Some((parent, action)) = self.nodes[at].parent {
            actions.push(action);
            at = parent;
        }
        actions.reverse();
        actions
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::VecDeque;

    const SIDE: usize = 12;

    /// A grid of cells, some of them walls, in which three of the actions stand for steps in three directions and a
    /// fourth for the fourth.
    struct Grid {
        walls: Vec<bool>,
        goal: (usize, usize),
        informed: bool,
    }

    const STEPS: [(Action, i32, i32); 4] =
        [(Action::MoveArmXP, 1, 0), (Action::MoveArmXM, -1, 0), (Action::MoveArmYP, 0, 1), (Action::MoveArmYM, 0, -1)];

    impl Graph for Grid {
        type State = (usize, usize);

        fn key(&self, &(x, y): &(usize, usize)) -> u64 {
            (y * SIDE + x) as u64
        }

        fn successors(&self, &(x, y): &(usize, usize), out: &mut Vec<(Action, (usize, usize))>) {
            for (action, along_x, along_y) in STEPS {
                let to = (x as i32 + along_x, y as i32 + along_y);
                if (0..SIDE as i32).contains(&to.0) && (0..SIDE as i32).contains(&to.1) {
                    out.push((action, (to.0 as usize, to.1 as usize)));
                }
            }
        }

        fn passable(&self, _: &(usize, usize), _: Action, &(x, y): &(usize, usize)) -> bool {
            !self.walls[y * SIDE + x]
        }

        fn bound(&self, &(x, y): &(usize, usize)) -> u32 {
            if self.informed { (x.abs_diff(self.goal.0) + y.abs_diff(self.goal.1)) as u32 } else { 0 }
        }
    }

    fn astar(grid: &Grid, expansions: u32) -> Option<Vec<Action>> {
        let mut search = Search::new(grid, (0, 0), expansions);
        while let Some(index) = search.next(grid) {
            if *search.state(index) == grid.goal {
                assert_eq!(search.cost(index) as usize, search.path(index).len());
                return Some(search.path(index));
            }
        }
        None
    }

    /// Length of the shortest way, by breadth.
    fn breadth_first(grid: &Grid) -> Option<usize> {
        let mut steps = vec![usize::MAX; SIDE * SIDE];
        steps[0] = 0;
        let mut queue = VecDeque::from([(0_usize, 0_usize)]);
        while let Some((x, y)) = queue.pop_front() {
            for (_, along_x, along_y) in STEPS {
                let (to_x, to_y) = (x.wrapping_add_signed(along_x as isize), y.wrapping_add_signed(along_y as isize));
                if to_x < SIDE
                    && to_y < SIDE
                    && !grid.walls[to_y * SIDE + to_x]
                    && steps[to_y * SIDE + to_x] == usize::MAX
                {
                    steps[to_y * SIDE + to_x] = steps[y * SIDE + x] + 1;
                    queue.push_back((to_x, to_y));
                }
            }
        }
        let found = steps[grid.goal.1 * SIDE + grid.goal.0];
        (found != usize::MAX).then_some(found)
    }

    proptest! {
        #[test]
        fn ways_are_as_short_as_by_breadth_and_lead_where_they_say(
            walls in proptest::collection::vec(proptest::bool::weighted(0.3), SIDE * SIDE),
            x in 0..SIDE, y in 0..SIDE, informed: bool,
        ) {
            let mut grid = Grid { walls, goal: (x, y), informed };
            grid.walls[0] = false;
            let way = astar(&grid, u32::MAX);
            prop_assert_eq!(way.as_ref().map(Vec::len), breadth_first(&grid));
            let mut at = (0, 0);
            for action in way.into_iter().flatten() {
                let mut next = Vec::new();
                grid.successors(&at, &mut next);
                let taken = next.into_iter().find(|(possible, _)| *possible == action);
                prop_assert!(taken.is_some_and(|(_, to)| grid.passable(&at, action, &to)));
                at = taken.unwrap().1;
            }
            if breadth_first(&grid).is_some() {
                prop_assert_eq!(at, grid.goal);
            }
        }
    }

    #[test]
    fn a_search_ends_at_its_limit() {
        let grid = Grid { walls: vec![false; SIDE * SIDE], goal: (SIDE - 1, SIDE - 1), informed: false };
        assert_eq!(astar(&grid, 20), None);
        assert!(astar(&grid, (SIDE * SIDE) as u32).is_some());
    }
}
