//! Configurations without what is their default.

use super::{Form, Table};
use serde_json::Value;

/// Leaves out of checked values of a table what is its default, at any depth.
pub fn without_defaults(table: &Table, value: &mut Value) {
    let Some(fields) = value.as_object_mut() else { return };
    let mut usual = table.defaults.map_or(Value::Null, |make| make());
    for field in table.fields {
        let Some(value) = fields.get_mut(field.name) else { continue };
        field.form.without_defaults(value);
        if let Some(usual) = usual.get_mut(field.name) {
            field.form.without_defaults(usual);
            if value == usual {
                fields.remove(field.name);
            }
        }
    }
}

impl Form {
    fn without_defaults(&self, value: &mut Value) {
        match self {
            Self::Table(table) => without_defaults(table, value),
            Self::Optional(form) | Self::Named(form) => form.without_defaults(value),
            Self::List(form) => {
                value.as_array_mut().into_iter().flatten().for_each(|v| form.without_defaults(v))
            }
            Self::ByName(form) => {
                value.as_object_mut().into_iter().flatten().for_each(|(_, v)| form.without_defaults(v));
            }
            Self::OneOf(choice) => {
                for variant in choice.variants {
                    if let (Some(form), Some(value)) = (variant.form, value.get_mut(variant.name)) {
                        form.without_defaults(value);
                    }
                }
            }
            Self::Kinds(choice) => {
                let variant = choice.variants.iter().find(|v| Some(v.name) == value["kind"].as_str());
                if let Some(form) = variant.and_then(|v| v.form) {
                    form.without_defaults(value);
                }
            }
            Self::Flag
            | Self::Count
            | Self::Number
            | Self::Text
            | Self::Span
            | Self::Numbers(_)
            | Self::Any => {}
        }
    }
}
