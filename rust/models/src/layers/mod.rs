//! Parts that several networks are made of.

pub(crate) mod attention;
pub(crate) mod edge;
pub(crate) mod embed;
pub(crate) mod map;
pub(crate) mod perceptron;
mod resnet;
pub(crate) mod social;
