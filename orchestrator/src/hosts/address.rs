//! This host's own address: what the others reach it by. All that a run listens on, it listens on there.

use anyhow::{Context, Result, bail};
use std::net::{IpAddr, Ipv4Addr, SocketAddr, ToSocketAddrs, UdpSocket};

/// Host 0's own address: that of `--interface`, otherwise what the rendezvous' name stands for.
pub fn of_first(rendezvous: &str, interface: Option<&str>) -> Result<IpAddr> {
    if let Some(interface) = interface {
        return of_interface(interface);
    }
    let meant = resolve(rendezvous)?;
    let here = local()?;
    if let Some(own) = meant.iter().map(SocketAddr::ip).find(|ip| here.iter().any(|(_, own)| own == ip)) {
        return Ok(own);
    }
    // Debian gives a host's own name an address of the loopback; the whole of 127.0.0.0/8 is this machine.
    if let Some(own) = meant.iter().map(SocketAddr::ip).find(IpAddr::is_loopback) {
        return Ok(own);
    }
    let own: Vec<_> = here.iter().map(|(name, ip)| format!("{ip} ({name})")).collect();
    bail!(
        "this is host 0, but the rendezvous {rendezvous} is {} and none of this host's addresses ({}): name host 0 there, \
         or its interface by --interface",
        meant.iter().map(|address| address.ip().to_string()).collect::<Vec<_>>().join(", "),
        own.join(", ")
    )
}

/// Another host's own address: that of `--interface`, otherwise the one from which the kernel reaches the rendezvous.
pub fn of_other(rendezvous: SocketAddr, interface: Option<&str>) -> Result<IpAddr> {
    if let Some(interface) = interface {
        return of_interface(interface);
    }
    let any: SocketAddr = if rendezvous.is_ipv4() { (Ipv4Addr::UNSPECIFIED, 0).into() } else { "[::]:0".parse()? };
    // Nothing is sent: to connect a datagram socket only asks for the route.
    let socket = UdpSocket::bind(any).context("cannot make a socket")?;
    socket.connect(rendezvous).with_context(|| format!("there is no way to {rendezvous}"))?;
    Ok(socket.local_addr()?.ip())
}

pub fn resolve(rendezvous: &str) -> Result<Vec<SocketAddr>> {
    let found: Vec<_> =
        rendezvous.to_socket_addrs().with_context(|| format!("cannot resolve the rendezvous {rendezvous}"))?.collect();
    if found.is_empty() {
        bail!("the rendezvous {rendezvous} has no address");
    }
    Ok(found)
}

/// The interface that has an address, for NCCL; none for one that nobody lists, as 127.0.0.2.
pub fn interface_of(own: IpAddr) -> Option<String> {
    local().ok()?.into_iter().find(|(_, ip)| *ip == own).map(|(name, _)| name)
}

fn of_interface(text: &str) -> Result<IpAddr> {
    if let Ok(ip) = text.parse::<IpAddr>() {
        // Whether it is this host's shows when somebody listens there.
        return if ip.to_canonical().is_unspecified() {
            bail!("--interface {text} would listen everywhere: name one address")
        } else {
            Ok(ip)
        };
    }
    let here = local()?;
    let of = |wanted: fn(&IpAddr) -> bool| here.iter().find(|(name, ip)| name == text && wanted(ip)).map(|(_, ip)| *ip);
    of(IpAddr::is_ipv4).or_else(|| of(IpAddr::is_ipv6)).with_context(|| {
        let mut names: Vec<_> = here.iter().map(|(name, _)| name.as_str()).collect();
        names.dedup();
        format!("there is no interface {text} with an address here; there are {}", names.join(", "))
    })
}

fn local() -> Result<Vec<(String, IpAddr)>> {
    let found = if_addrs::get_if_addrs().context("cannot list this host's addresses")?;
    Ok(found.into_iter().map(|interface| (interface.name.clone(), interface.ip())).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hosts_address_is_one_of_its_own_and_never_all() {
        let loopback: IpAddr = Ipv4Addr::LOCALHOST.into();
        assert_eq!(of_first("127.0.0.1:7000", None).unwrap(), loopback);
        assert_eq!(of_first("nowhere.invalid:7000", Some("lo")).unwrap(), loopback);
        assert_eq!(of_first("127.0.0.1:7000", Some("127.0.0.3")).unwrap().to_string(), "127.0.0.3");
        assert_eq!(of_other("127.0.0.1:7000".parse().unwrap(), None).unwrap(), loopback);
        assert_eq!(interface_of(loopback).as_deref(), Some("lo"));
        // An address kept for documents: nobody has it.
        let message = of_first("192.0.2.1:7000", None).unwrap_err().to_string();
        assert!(message.contains("192.0.2.1") && message.contains("--interface"), "{message}");
        let message = of_first("127.0.0.1:7000", Some("nic9")).unwrap_err().to_string();
        assert!(message.contains("no interface nic9") && message.contains("lo"), "{message}");
        assert!(of_first("127.0.0.1:7000", Some("0.0.0.0")).unwrap_err().to_string().contains("everywhere"));
    }
}
