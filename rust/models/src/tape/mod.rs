//! The backend that networks are trained with on a processor: the kernels of `ccdiff-nets`, with gradients.
//!
//! Every operation notes on this thread how gradients go through it; [`learnt`] walks the notes from the last to the first. Losses
//! are torch's.
//! Sums are those of [`kernels::How::Fused`]: the same bits in every run on one kind of processor.

mod attention;
mod layers;
mod ops;

pub use layers::{Parameters, Place};

use crate::config::{HistoryTokens, ModelConfig};
use crate::torch::to_vec;
use crate::trains::Trains;
use ccdiff_nets::compute::cpu::Array;
use ccdiff_nets::kernels::{self, PANEL};
use std::cell::{Cell, RefCell};
use std::fmt;
use std::rc::Rc;
use tch::Tensor;

/// Layers on the kernels, with gradients.
#[derive(Debug)]
pub struct Tape;

impl Tape {
    /// Whether it has all layers of a network.
    pub fn fits(config: &ModelConfig) -> bool {
        let tokens = config.network().is_ok_and(|network| network.samples_tokens);
        let head = if tokens { config.edge_width } else { config.width / config.heads };
        config.history == HistoryTokens::Summary && head % PANEL as i64 == 0
    }
}

thread_local! {
    /// How gradients of what was made become those of what it was made of.
    static NOTES: RefCell<Vec<Box<dyn FnOnce()>>> = const { RefCell::new(Vec::new()) };
}

fn note(pull: impl FnOnce() + 'static) {
    NOTES.with_borrow_mut(|notes| notes.push(Box::new(pull)));
}

/// Numbers [rows, tokens, width] and, once they are known, their gradient.
pub struct Node {
    array: Array,
    /// Whether they depend on weights.
    learns: bool,
    gradient: Cell<Vec<f32>>,
}

/// A node that several operations read.
#[derive(Clone)]
pub struct Var(Rc<Node>);

impl fmt::Debug for Var {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "[{}, {}, {}]", self.rows(), self.tokens, self.width)
    }
}

impl std::ops::Deref for Var {
    type Target = Node;

    fn deref(&self) -> &Node {
        &self.0
    }
}

impl std::ops::Deref for Node {
    type Target = Array;

    fn deref(&self) -> &Array {
        &self.array
    }
}

impl Node {
    /// Adds to the gradient, where one is wanted.
    fn learn(&self, gradient: Vec<f32>) {
        if !self.learns {
            return;
        }
        let mut known = self.gradient.take();
        if known.is_empty() {
            known = gradient;
        } else {
            kernels::add_cycle(&mut known, &gradient);
        }
        self.gradient.set(known);
    }
}

impl Var {
    /// Numbers that depend on no weight.
    fn of(array: Array) -> Self {
        Self(Rc::new(Node { array, learns: false, gradient: Cell::default() }))
    }

    /// What an operation made; `learns` says whether it read weights or what depends on them.
    fn made(array: Array, learns: bool, pull: impl FnOnce(&Node, Vec<f32>) + 'static) -> Self {
        let made = Self(Rc::new(Node { array, learns, gradient: Cell::default() }));
        if learns {
            let made = made.clone();
            note(move || {
                let gradient = made.gradient.take();
                if !gradient.is_empty() {
                    pull(&made, gradient);
                }
            });
        }
        made
    }

    /// Another form of the same number of tokens: numbers and gradients go through functions.
    fn through(&self, array: Array, pull: impl FnOnce(&Node, Vec<f32>) -> Vec<f32> + 'static) -> Self {
        let from = self.clone();
        Self::made(array, self.learns, move |made, gradient| from.learn(pull(made, gradient)))
    }

    fn shaped(&self, tokens: usize, width: usize) -> Self {
        self.through(Array::new(tokens, width, self.numbers.clone()), |_, gradient| gradient)
    }
}

impl Trains for Tape {
    fn leaf(x: &Var, size: &[i64]) -> Tensor {
        let leaf = Tensor::from_slice(&x.numbers).view(size).set_requires_grad(true);
        let (x, read) = (x.clone(), leaf.shallow_clone());
        note(move || x.learn(to_vec(&read.grad())));
        leaf
    }
}

/// The loss that is made of leaves; brings its gradient to all weights that they depend on.
pub fn learnt(loss: impl FnOnce() -> Tensor) -> f64 {
    // what a step that failed has left
    drop(NOTES.take());
    let loss = loss();
    loss.backward();
    for pull in NOTES.take().into_iter().rev() {
        pull();
    }
    loss.double_value(&[])
}
