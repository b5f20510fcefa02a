#!/bin/sh
# two_hosts.sh PROGRAM ARGS...: the program with one rank on each of two hosts, which are network namespaces joined by a
# cable; what the first sent and received goes to standard error. Where nobody may make namespaces both ranks are on this
# host, and talk over its loopback interface.
set -eu
export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1

over_loopback() {
  echo "no network namespaces here: over the loopback interface" >&2
  counted() { awk -F'[: ]+' '$2 == "lo" {print $11}' /proc/net/dev; }
  before=$(counted) status=0
  mpirun -n 2 --oversubscribe --mca mpi_yield_when_idle 1 --mca btl tcp,self --mca btl_tcp_if_include lo "$@" || status=$?
  echo "sent $(($(counted) - before)) bytes" >&2
  exit $status
}

if [ "$(id -u)" != 0 ]; then
  unshare -Urnm true 2>/dev/null || over_loopback "$@"
  exec unshare -Urnm sh -c 'mount -t tmpfs none /run && exec "$0" "$@"' "$0" "$@"
fi
a=terse_a_$$ b=terse_b_$$
ip netns add $a 2>/dev/null || over_loopback "$@"
work=$(mktemp -d)
trap 'ip netns del $a; ip netns del $b 2>/dev/null; rm -rf "$work"' EXIT
ip netns add $b
ip -n $a link add cable type veth peer name cable netns $b
ip -n $a addr add 10.77.0.1/24 dev cable
ip -n $b addr add 10.77.0.2/24 dev cable
for host in $a $b; do
  ip -n $host link set lo up
  ip -n $host link set cable up
done
mkdir "$work/a" "$work/b"
# What mpirun takes for ssh: HOST COMMAND...
cat > "$work/agent" <<EOF
#!/bin/sh
shift
exec ip netns exec $b unshare --uts sh -c "hostname terse-b; export TMPDIR=$work/b; \$*"
EOF
chmod +x "$work/agent"
status=0
ip netns exec $a unshare --uts sh -c 'hostname terse-a; exec "$@"' sh env TMPDIR="$work/a" \
  mpirun --mca plm_rsh_agent "$work/agent" --host 10.77.0.1:1,10.77.0.2:1 -n 2 --mca mpi_yield_when_idle 1 \
  --mca oob_tcp_if_include 10.77.0.0/24 --mca btl_tcp_if_include 10.77.0.0/24 --mca btl tcp,self "$@" || status=$?
ip -n $a -s link show cable | awk '/RX:/ {getline; print "received", $1, "bytes"} /TX:/ {getline; print "sent", $1, "bytes"}' >&2
exit $status
