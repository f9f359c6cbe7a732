//! Checks that libtorch is the release tch was made for, and gives this crate's tests an rpath to it.
const TORCH: &str = "2.11.0";

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    let Ok(lib) = std::env::var("DEP_TCH_LIBTORCH_LIB") else { return };
    let version_py = std::path::Path::new(&lib).with_file_name("version.py");
    println!("cargo:rerun-if-changed={}", version_py.display());
    if let Ok(text) = std::fs::read_to_string(&version_py) {
        let found = text
            .lines()
            .find_map(|l| l.strip_prefix("__version__ = "))
            .unwrap_or("?")
            .trim_matches(['\'', '"']);
        assert!(
            found.split('+').next() == Some(TORCH),
            "libtorch at {lib} is torch {found}, this build wants {TORCH}"
        );
    }
    println!("cargo:rustc-link-arg=-Wl,-rpath,{lib}");
}
