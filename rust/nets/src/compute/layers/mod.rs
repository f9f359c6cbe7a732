//! Parts that several networks are made of, over any [`crate::compute::backend::Backend`].

pub mod attention;
pub mod edge;
pub mod embed;
pub mod map;
pub mod perceptron;
pub mod social;
