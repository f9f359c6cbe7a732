//! Options: structs of a configuration as tables of fields, and the one walker that checks values against them.
//!
//! [`options!`](crate::options!) makes a struct, its default and its [`Table`] from one list of fields, [`choices!`](crate::choices!)
//! an enum and its [`Choice`]. A [`Table`] goes out as JSON: the dataclasses of Python and `docs/configuration.md` are
//! written from it. What contradicts another field is checked beside the struct.

mod defaults;

pub use defaults::without_defaults;

use crate::error::{Result, SimError};
use crate::geom::Real;
use serde::de::DeserializeOwned;
use serde::{Serialize, Serializer};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt;

/// Numbers that are allowed, with both ends: what is larger hangs, fills the memory or means nothing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Range {
    low: f64,
    high: f64,
    low_in: bool,
    high_in: bool,
}

/// From the first to the last, both included.
pub const fn within(low: f64, high: f64) -> Range {
    Range { low, high, low_in: true, high_in: true }
}

/// Weights and other factors of either sign.
pub const WEIGHT: Range = within(-1e6, 1e6);
/// Lengths of either sign, metres; accelerations and speeds, m/s² and m/s: more than anything on a road.
pub const MOTION: Range = within(-100.0, 100.0);
/// The same above 0.
pub const POSITIVE_MOTION: Range = within(0.0, 100.0).open_below();
/// Strengths of guidance.
pub const CRITICALITY: Range = within(0.0, 10.0);

impl Range {
    /// The same without its lower end.
    pub const fn open_below(self) -> Self {
        Self { low_in: false, ..self }
    }

    /// The same without its upper end.
    pub const fn open_above(self) -> Self {
        Self { high_in: false, ..self }
    }

    /// Whether a number is allowed.
    pub fn holds(&self, x: f64) -> bool {
        (x > self.low || self.low_in && x == self.low) && (x < self.high || self.high_in && x == self.high)
    }
}

impl fmt::Display for Range {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { low, high, low_in, high_in } = self;
        let (left, right) = (if *low_in { '[' } else { '(' }, if *high_in { ']' } else { ')' });
        write!(f, "in {left}{low}, {high}{right}")
    }
}

impl Serialize for Range {
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// What a value looks like in JSON.
#[derive(Debug, Clone, Copy, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Form {
    /// `true` or `false`.
    Flag,
    /// A whole number of at least 0.
    Count,
    /// A finite number.
    Number,
    /// A string.
    Text,
    /// Lowest and highest, in order.
    Span,
    /// So many numbers.
    Numbers(usize),
    /// Any number of values.
    List(&'static Form),
    /// A value, or nothing.
    Optional(&'static Form),
    /// Values by names.
    ByName(&'static Form),
    /// A name whose meaning is looked up later, or a value.
    Named(&'static Form),
    /// One of several; those with a value of their own are `{name: value}`.
    OneOf(&'static Choice),
    /// One of several tables, with its name as a field `kind`.
    Kinds(&'static Choice),
    /// Fields.
    Table(#[serde(serialize_with = "name_of")] &'static Table),
    /// Anything; its reader checks it.
    Any,
}

fn name_of<S: Serializer>(table: &Table, serializer: S) -> std::result::Result<S::Ok, S::Error> {
    serializer.serialize_str(table.name)
}

/// An enum of a configuration.
#[derive(Debug, Serialize)]
pub struct Choice {
    /// Name of the type.
    pub name: &'static str,
    /// What is chosen.
    pub doc: &'static str,
    /// What there is to choose from.
    pub variants: &'static [Variant],
}

/// One of several.
#[derive(Debug, Serialize)]
pub struct Variant {
    /// Name in JSON.
    pub name: &'static str,
    /// What it means.
    pub doc: &'static str,
    /// Its value, if it has one.
    pub form: Option<Form>,
}

/// A struct of a configuration.
#[derive(Debug, Serialize)]
pub struct Table {
    /// Name of the type, here and in Python.
    pub name: &'static str,
    /// What is chosen.
    pub doc: &'static str,
    /// Its fields.
    pub fields: &'static [Field],
    /// All defaults as JSON; without them every field must be given.
    #[serde(serialize_with = "written")]
    pub defaults: Option<fn() -> Value>,
}

fn written<S: Serializer>(
    defaults: &Option<fn() -> Value>,
    serializer: S,
) -> std::result::Result<S::Ok, S::Error> {
    defaults.map(|make| make()).serialize(serializer)
}

/// A field of a [`Table`].
#[derive(Debug, Serialize)]
pub struct Field {
    /// Name.
    pub name: &'static str,
    /// What it means, and what happens when it is too small or too large.
    pub doc: &'static str,
    /// Unit; empty without one.
    pub unit: &'static str,
    /// Numbers that are allowed: of the value, or of all in it.
    pub range: Option<Range>,
    /// What it looks like.
    pub form: Form,
}

/// A type of values in a configuration.
pub trait Setting {
    /// What it looks like in JSON.
    const FORM: Form;
}

macro_rules! settings {
    ($($type:ty: $form:expr;)*) => { $(impl Setting for $type { const FORM: Form = $form; })* };
}

settings! {
    bool: Form::Flag;
    usize: Form::Count;
    u64: Form::Count;
    i64: Form::Count;
    f32: Form::Number;
    f64: Form::Number;
    String: Form::Text;
    [Real; 2]: Form::Span;
    Value: Form::Any;
}

impl<const N: usize> Setting for [f64; N] {
    const FORM: Form = Form::Numbers(N);
}

impl<T: Setting> Setting for Vec<T> {
    const FORM: Form = Form::List(&T::FORM);
}

impl<T: Setting> Setting for Option<T> {
    const FORM: Form = Form::Optional(&T::FORM);
}

impl<T: Setting> Setting for BTreeMap<String, T> {
    const FORM: Form = Form::ByName(&T::FORM);
}

/// A struct of a configuration from a list `name: type = default, unit "m/s", range within(0.0, 100.0);`, in which unit and range may
/// be left out. Without defaults every field must be given, and `serde(default)` is left out, too. `#[serde(default)]` on a
/// field alone: files from before it are read as if its type's default stood in them.
#[macro_export]
macro_rules! options {
    (
        $(#[doc = $about:literal])+
        #[derive($($derive:ident),+)]
        $(#[serde($($serde:ident),+)])?
        pub struct $name:ident {
            $(
                $(#[doc = $doc:literal])+
                $(#[serde($later:ident $(= $path:literal)?)])?
                $field:ident: $type:ty $(= $default:expr)? $(, unit $unit:literal)? $(, range $range:expr)?;
            )+
        }
    ) => {
        $(#[doc = $about])+
        #[derive(Debug, PartialEq, serde::Serialize, serde::Deserialize, $($derive),+)]
        $(#[serde($($serde),+)])?
        pub struct $name {
            $($(#[doc = $doc])+ $(#[serde($later $(= $path)?)])? pub $field: $type,)+
        }

        $crate::options!(@default $name; $($field $(= $default)?;)+);

        impl $crate::options::Setting for $name {
            const FORM: $crate::options::Form = $crate::options::Form::Table(&Self::TABLE);
        }

        impl $name {
            /// Its fields, with defaults, units, ranges and meanings.
            pub const TABLE: $crate::options::Table = $crate::options::Table {
                name: stringify!($name),
                doc: concat!($($about, "\n"),+),
                fields: &[$($crate::options::Field {
                    name: stringify!($field),
                    doc: concat!($($doc, "\n"),+),
                    unit: concat!($($unit)?),
                    range: $crate::options!(@range $($range)?),
                    form: <$type as $crate::options::Setting>::FORM,
                }),+],
                defaults: $crate::options!(@defaults $($($default)?),+),
            };
        }
    };
    (@default $name:ident; $($field:ident = $default:expr;)+) => {
        impl Default for $name {
            fn default() -> Self {
                Self { $($field: $default),+ }
            }
        }
    };
    (@default $name:ident; $($field:ident;)+) => {};
    (@range) => { None };
    (@range $range:expr) => { Some($range) };
    (@defaults $(,)*) => { None };
    (@defaults $($default:expr),+) => { Some(|| $crate::options::to_value(&Self::default())) };
}

/// An enum of a configuration from a list `Variant = "name",` or `Variant(Type) = "name",`; `Variant = "name" default,` is the
/// one that `derive(Default)` takes.
#[macro_export]
macro_rules! choices {
    (
        $(#[doc = $about:literal])+
        #[derive($($derive:ident),+)]
        $(#[serde(tag = $tag:literal)])?
        pub enum $name:ident {
            $($(#[doc = $doc:literal])+ $variant:ident $(($type:ty))? = $text:literal $($mark:ident)?,)+
        }
    ) => {
        $(#[doc = $about])+
        #[derive(Debug, PartialEq, serde::Serialize, serde::Deserialize, $($derive),+)]
        $(#[serde(tag = $tag)])?
        pub enum $name {
            $($(#[doc = $doc])+ $(#[$mark])? #[serde(rename = $text)] $variant $(($type))?,)+
        }

        impl $name {
            /// Name in JSON.
            pub fn name(&self) -> &'static str {
                match self {
                    $(Self::$variant { .. } => $text,)+
                }
            }
        }

        impl $crate::options::Setting for $name {
            const FORM: $crate::options::Form = $crate::choices!(@form $($tag)?)(&$crate::options::Choice {
                name: stringify!($name),
                doc: concat!($($about, "\n"),+),
                variants: &[$($crate::options::Variant {
                    name: $text,
                    doc: concat!($($doc, "\n"),+),
                    form: $crate::choices!(@value $($type)?),
                }),+],
            });
        }
    };
    (@form) => { $crate::options::Form::OneOf };
    (@form $tag:literal) => { $crate::options::Form::Kinds };
    (@value) => { None };
    (@value $type:ty) => { Some(<$type as $crate::options::Setting>::FORM) };
}

/// A value as it would be read back: numbers of 32 bits have their short form, what is not finite is null.
#[doc(hidden)]
pub fn to_value<T: Serialize>(value: &T) -> Value {
    let text = serde_json::to_string(value).unwrap_or_default();
    serde_json::from_str(&text).unwrap_or_default()
}

/// Reads JSON as a configuration and checks every name, type and range; `path` is its place, empty at the top.
///
/// # Errors
/// [`SimError::Config`] names the first field that is wrong.
pub fn read<T: Setting + DeserializeOwned>(path: &str, text: &str) -> Result<T> {
    let wrong = |e: serde_json::Error| {
        let field = if path.is_empty() { "json" } else { path };
        wrong(field, e.to_string(), "JSON of a configuration")
    };
    T::FORM.check(path, None, &serde_json::from_str(text).map_err(wrong)?)?;
    // from the text: numbers of 32 bits are rounded once
    serde_json::from_str(text).map_err(wrong)
}

/// Checks every range of a configuration.
///
/// # Errors
/// [`SimError::Config`] names the first field that is out of its range.
pub fn check<T: Setting + Serialize>(path: &str, value: &T) -> Result<()> {
    T::FORM.check(path, None, &to_value(value))
}

fn wrong(field: &str, got: impl ToString, expected: impl Into<String>) -> SimError {
    SimError::config(field.to_owned(), got, expected)
}

fn inside(path: &str, name: &str) -> String {
    if path.is_empty() { name.to_owned() } else { format!("{path}.{name}") }
}

/// Checks JSON against a table without making a struct of it; `path` is its place.
///
/// # Errors
/// [`SimError::Config`] names the first field that is wrong.
pub fn check_table(table: &Table, path: &str, text: &str) -> Result<()> {
    let value = serde_json::from_str(text).map_err(|e| wrong(path, e, "JSON of a configuration"))?;
    table.check(path, &value)
}

impl Form {
    fn check(&self, path: &str, range: Option<&Range>, value: &Value) -> Result<()> {
        let allowed = |x: f64| range.is_none_or(|r| r.holds(x));
        let ranged = |what: &str| range.map_or_else(|| what.to_owned(), |r| format!("{what} {r}"));
        let fail = |expected: String| Err(wrong(path, value, expected));
        let fits = |ok: bool, expected: &str| if ok { Ok(()) } else { fail(ranged(expected)) };
        let number = |v: &Value| v.as_f64().filter(|x| x.abs() <= f64::from(Real::MAX) && allowed(*x));
        match self {
            Self::Any => Ok(()),
            Self::Optional(_) if value.is_null() => Ok(()),
            Self::Named(_) if value.is_string() => Ok(()),
            Self::Optional(form) | Self::Named(form) => form.check(path, range, value),
            Self::Flag => fits(value.is_boolean(), "true or false"),
            Self::Text => fits(value.is_string(), "a name"),
            Self::Count => fits(value.as_u64().is_some_and(|n| allowed(n as f64)), "a whole number"),
            Self::Number => fits(number(value).is_some(), "a number"),
            Self::Span => {
                let ends = value.as_array().and_then(|v| <&[Value; 2]>::try_from(v.as_slice()).ok());
                let ends = ends.and_then(|[low, high]| Some((number(low)?, number(high)?)));
                fits(ends.is_some_and(|(low, high)| low <= high), "lowest and highest, numbers in order")
            }
            Self::Numbers(count) => {
                let values = value.as_array().filter(|v| v.len() == *count);
                fits(
                    values.is_some_and(|v| v.iter().all(|v| number(v).is_some())),
                    &format!("{count} numbers"),
                )
            }
            Self::List(form) => {
                let Some(values) = value.as_array() else { return fail("a list".into()) };
                let mut values = values.iter().enumerate();
                values.try_for_each(|(i, v)| form.check(&format!("{path}[{i}]"), range, v))
            }
            Self::ByName(form) => {
                let Some(values) = value.as_object() else { return fail("values by name".into()) };
                values.iter().try_for_each(|(name, v)| form.check(&inside(path, name), range, v))
            }
            Self::OneOf(choice) => {
                let (name, content) = match value {
                    Value::String(name) => (name.as_str(), None),
                    Value::Object(one) if one.len() == 1 => {
                        one.iter().next().map_or(("", None), |(name, v)| (name.as_str(), Some(v)))
                    }
                    _ => ("", None),
                };
                let variant = choice.variants.iter().find(|v| v.name == name);
                match (variant.map(|v| v.form), content) {
                    (Some(None), None) => Ok(()),
                    (Some(Some(form)), Some(content)) => form.check(&inside(path, name), range, content),
                    _ => fail(choice.names()),
                }
            }
            Self::Kinds(choice) => {
                let kind = value.get("kind").and_then(Value::as_str);
                let variant = choice.variants.iter().find(|v| Some(v.name) == kind);
                let (Some(variant), Some(fields)) = (variant, value.as_object()) else {
                    return fail(format!("fields with a kind of {}", choice.names()));
                };
                let fields = fields.iter().filter(|(name, _)| *name != "kind");
                let rest = Value::Object(fields.map(|(name, v)| (name.clone(), v.clone())).collect());
                variant.form.map_or(Ok(()), |form| form.check(path, range, &rest))
            }
            Self::Table(table) => table.check(path, value),
        }
    }
}

impl Choice {
    fn names(&self) -> String {
        let names: Vec<&str> = self.variants.iter().map(|v| v.name).collect();
        format!("one of {}", names.join(", "))
    }
}

impl Table {
    fn check(&self, path: &str, value: &Value) -> Result<()> {
        let Some(values) = value.as_object() else {
            return Err(wrong(
                if path.is_empty() { "json" } else { path },
                value,
                format!("the fields of {}", self.name),
            ));
        };
        for name in values.keys() {
            if !self.fields.iter().any(|f| f.name == name) {
                let names: Vec<&str> = self.fields.iter().map(|f| f.name).collect();
                return Err(wrong(&inside(path, name), "no option", format!("one of {}", names.join(", "))));
            }
        }
        for field in self.fields {
            let at = inside(path, field.name);
            match values.get(field.name) {
                Some(value) => field.form.check(&at, field.range.as_ref(), value)?,
                None if self.defaults.is_none() => return Err(wrong(&at, "missing", "a value")),
                None => {}
            }
        }
        Ok(())
    }
}
