#![allow(unreachable_pub, reason = "the tables of configurations are public")]
use super::*;

options! {
    /// A part.
    #[derive(Clone)]
    #[serde(deny_unknown_fields)]
    pub struct Part {
        /// Sizes.
        sizes_m: Vec<f32>, unit "m", range within(0.0, 2.0).open_below();
    }
}

choices! {
    /// A way.
    #[derive(Clone)]
    pub enum Way {
        /// Plain.
        Plain = "plain",
        /// With a part.
        Parted(Part) = "parted",
    }
}

options! {
    /// A whole.
    #[derive(Clone)]
    #[serde(deny_unknown_fields, default)]
    pub struct Whole {
        /// A number.
        speed_mps: f32 = 0.1, unit "m/s", range within(0.0, 100.0).open_below();
        /// Its way.
        way: Way = Way::Plain;
        /// A count, or none.
        count: Option<usize> = None, range within(1.0, 1024.0);
        /// Two ends.
        span_m: [f32; 2] = [-1.0, 1.0], unit "m";
    }
}

options! {
    /// What holds others.
    #[derive(Clone)]
    #[serde(deny_unknown_fields, default)]
    pub struct Outer {
        /// One.
        inner: Whole = Whole::default();
        /// More, by name.
        more: BTreeMap<String, Whole> = BTreeMap::new();
    }
}

#[test]
fn what_is_wrong_is_named_with_its_path_and_its_rule() {
    for (json, message) in [
        (r#"{"speed_mps": 0}"#, "config: speed_mps is 0, expected a number in (0, 100]"),
        (r#"{"speed_mps": 1e39}"#, "config: speed_mps is 1e+39, expected a number in (0, 100]"),
        (r#"{"count": 0}"#, "config: count is 0, expected a whole number in [1, 1024]"),
        (r#"{"count": 1.5}"#, "config: count is 1.5, expected a whole number in [1, 1024]"),
        (r#"{"sped": 1}"#, "config: sped is no option, expected one of speed_mps, way, count, span_m"),
        (r#"{"way": "parted"}"#, "config: way is \"parted\", expected one of plain, parted"),
        (r#"{"way": {"parted": {}}}"#, "config: way.parted.sizes_m is missing, expected a value"),
        (
            r#"{"way": {"parted": {"sizes_m": [1, 2.5]}}}"#,
            "config: way.parted.sizes_m[1] is 2.5, expected a number in (0, 2]",
        ),
        (r#"{"span_m": [2, 1]}"#, "config: span_m is [2,1], expected lowest and highest, numbers in order"),
        ("[]", "config: json is [], expected the fields of Whole"),
    ] {
        assert_eq!(read::<Whole>("", json).unwrap_err().to_string(), message);
    }
    assert_eq!(Way::Plain.name(), "plain");
    let bad = Whole { speed_mps: Real::NAN, ..Whole::default() };
    assert_eq!(
        check("a.b", &bad).unwrap_err().to_string(),
        "config: a.b.speed_mps is null, expected a number in (0, 100]"
    );
}

#[test]
fn without_its_defaults_a_configuration_has_what_differs_at_any_depth() {
    let lean = |json: &str| {
        let mut value = serde_json::from_str(json).unwrap();
        without_defaults(&Outer::TABLE, &mut value);
        value.to_string()
    };
    assert_eq!(lean(&to_value(&Outer::default()).to_string()), "{}");
    // as it was written before there were the other options
    assert_eq!(lean(r#"{"inner": {"speed_mps": 0.1, "way": "plain"}}"#), "{}");
    assert_eq!(lean(r#"{"inner": {"speed_mps": 0.2, "count": null}}"#), r#"{"inner":{"speed_mps":0.2}}"#);
    let by_name = r#"{"more": {"a": {"count": 2, "span_m": [-1.0, 1.0]}}}"#;
    assert_eq!(lean(by_name), r#"{"more":{"a":{"count":2}}}"#);
}
