//! Checks that the patches of `sim/plants/run`, which plant bugs, still apply to the changing sources.

use std::path::Path;
use std::process::Command;

#[test]
fn every_patch_fits_the_sources() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    if Command::new("git").arg("--version").output().is_err() {
        println!("skipped: there is no git here");
        return;
    }
    let patches =
        std::fs::read_dir(root.join("sim/plants")).expect("a folder").map(|entry| entry.expect("a file").path());
    let patches: Vec<_> = patches.filter(|path| path.extension().is_some_and(|is| is == "patch")).collect();
    assert_eq!(patches.len(), 39);
    for patch in patches {
        let ran = Command::new("git").current_dir(&root).args(["apply", "--check"]).arg(&patch).output().expect("git");
        assert!(ran.status.success(), "{}: {}", patch.display(), String::from_utf8_lossy(&ran.stderr));
    }
}
