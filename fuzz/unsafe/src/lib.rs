//! The lanes of the depth camera, and the words that processes share, each as it stands in the product.

#[path = "../../../proto/wire/src/shm.rs"]
pub mod shm;
#[path = "../../../actor/simulator/src/depth/simd.rs"]
pub mod simd;

/// Miri knows no mapped files.
#[cfg(all(test, not(miri)))]
mod tests {
    use super::shm::Words;

    #[test]
    fn words_are_read_and_written_by_several_threads_to_the_last_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("words");
        Words::create(&path, 600).unwrap();
        assert!(Words::open(&path, 601, false).is_err());
        // A mapping stays on its thread; each has its own.
        let open = |writable| Words::open(&path, 600, writable).unwrap();
        std::thread::scope(|scope| {
            scope.spawn(|| {
                let words = open(true);
                (1..=1000).for_each(|value| (0..600).for_each(|index| words.store(index, value)));
            });
            scope.spawn(|| {
                let words = open(false);
                let began = std::time::Instant::now();
                while words.load(599) < 1000 {
                    assert!(began.elapsed().as_secs() < 60, "the writer has ended");
                }
            });
        });
        let reader = open(false);
        assert!((0..600).all(|index| reader.load(index) == 1000));
    }
}
