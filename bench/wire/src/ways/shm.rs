//! POSIX shared memory by hand: one slot for each half of each actor, and semaphores. Nothing is recovered when a
//! process dies, and nobody can read along.

use crate::end::{ActorEnd, LearnerEnd, Place};
use anyhow::{Context, Result, ensure};
use rustix::mm::{MapFlags, ProtFlags, mmap};
use std::fs::{File, OpenOptions};
use std::io::Error;
use std::path::PathBuf;
use std::ptr::null_mut;

pub fn path(place: &Place) -> PathBuf {
    PathBuf::from(wire::SHARED_MEMORY).join(format!("stillroom-bench-{}", place.cell))
}

/// Room for a semaphore or an actor's actions, apart from its neighbours.
const LINE: usize = 128;

/// The segment: two semaphores of the learner's, then a semaphore and two answers for each actor, then the slots.
struct Segment {
    base: *mut u8,
    place: Place,
}

impl Segment {
    fn map(place: &Place, file: &File) -> Result<Self> {
        let size = Self::slots(place) + place.actors as usize * 2 * place.bytes();
        file.set_len(size as u64).context("cannot size the segment")?;
        // SAFETY: a new mapping, at an address that the kernel chooses, which stays until the process ends.
        let base = unsafe { mmap(null_mut(), size, ProtFlags::READ | ProtFlags::WRITE, MapFlags::SHARED, file, 0) };
        Ok(Self { base: base.context("cannot map the segment")?.cast(), place: place.clone() })
    }

    fn slots(place: &Place) -> usize {
        (2 * LINE + place.actors as usize * 3 * LINE).next_multiple_of(4096)
    }

    fn ready(&self, half: u32) -> *mut libc::sem_t {
        // SAFETY: inside the mapping.
        unsafe { self.base.add(half as usize * LINE) }.cast()
    }

    fn answered(&self, actor: u32) -> *mut libc::sem_t {
        // SAFETY: inside the mapping.
        unsafe { self.base.add((2 + actor as usize * 3) * LINE) }.cast()
    }

    fn answer(&self, actor: u32, half: u32) -> *mut u8 {
        // SAFETY: inside the mapping.
        unsafe { self.base.add((3 + actor as usize * 3 + half as usize) * LINE) }
    }

    fn slot(&self, actor: u32, half: u32) -> *mut u8 {
        let index = actor as usize * 2 + half as usize;
        // SAFETY: inside the mapping.
        unsafe { self.base.add(Self::slots(&self.place) + index * self.place.bytes()) }
    }
}

fn post(semaphore: *mut libc::sem_t) -> Result<()> {
    // SAFETY: an initialised semaphore of the mapping.
    ensure!(unsafe { libc::sem_post(semaphore) } == 0, "sem_post: {}", Error::last_os_error());
    Ok(())
}

fn wait(semaphore: *mut libc::sem_t) -> Result<()> {
    // SAFETY: an initialised semaphore of the mapping.
    while unsafe { libc::sem_wait(semaphore) } != 0 {
        let error = Error::last_os_error();
        ensure!(error.kind() == std::io::ErrorKind::Interrupted, "sem_wait: {error}");
    }
    Ok(())
}

pub struct Learner(Segment);

impl Learner {
    pub fn open(place: &Place) -> Result<Self> {
        ensure!(place.frames as usize <= LINE, "the answers of a half have room for {LINE} bytes");
        let file = OpenOptions::new().read(true).write(true).create_new(true).open(path(place));
        let segment = Segment::map(place, &file.with_context(|| path(place).display().to_string())?)?;
        let semaphores = (0..2).map(|half| segment.ready(half));
        for semaphore in semaphores.chain((0..place.actors).map(|actor| segment.answered(actor))) {
            // SAFETY: room for a semaphore, which nobody uses yet.
            ensure!(unsafe { libc::sem_init(semaphore, 1, 0) } == 0, "sem_init: {}", Error::last_os_error());
        }
        Ok(Self(segment))
    }
}

impl LearnerEnd for Learner {
    fn receive(&mut self, half: u32, each: &mut dyn FnMut(u32, &[u8])) -> Result<()> {
        let actors = self.0.place.actors;
        (0..actors).try_for_each(|_| wait(self.0.ready(half)))?;
        for actor in 0..actors {
            // SAFETY: the actor has written its slot and waits for the answer.
            each(actor, unsafe { std::slice::from_raw_parts(self.0.slot(actor, half), self.0.place.bytes()) });
        }
        Ok(())
    }

    fn answer(&mut self, half: u32, action: u8) -> Result<()> {
        for actor in 0..self.0.place.actors {
            // SAFETY: the actor waits for it.
            unsafe { self.0.answer(actor, half).write_bytes(action, self.0.place.frames as usize) };
            post(self.0.answered(actor))?;
        }
        Ok(())
    }
}

pub struct Actor {
    segment: Segment,
    number: u32,
    /// The learner answers halves in turn.
    next: u32,
}

impl Actor {
    pub fn open(place: &Place, number: u32) -> Result<Self> {
        let file = OpenOptions::new().read(true).write(true).open(path(place));
        let segment = Segment::map(place, &file.with_context(|| path(place).display().to_string())?)?;
        Ok(Self { segment, number, next: 0 })
    }
}

impl ActorEnd for Actor {
    fn send(&mut self, half: u32, pattern: u8) -> Result<()> {
        let slot = self.segment.slot(self.number, half);
        // SAFETY: the slot is the actor's until it posts.
        unsafe { slot.write_bytes(pattern, self.segment.place.bytes()) };
        post(self.segment.ready(half))
    }

    fn wait(&mut self) -> Result<(u32, u8)> {
        wait(self.segment.answered(self.number))?;
        let half = self.next;
        self.next = (half + 1) % self.segment.place.halves();
        // SAFETY: the learner wrote it before it posted.
        Ok((half, unsafe { self.segment.answer(self.number, half).read() }))
    }
}
